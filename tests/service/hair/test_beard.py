"""A beard of strands: where one grows, how long, and how it follows the face."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from service.arrays import Float32
from service.face.fit.fit import Fit
from service.face.reading.part_labels import BACKGROUND, BEARD, PARTS, SKIN
from service.face.reading.reader import PART_CELLS, Reading
from service.face.region import Region
from service.geometry.raster import rasterise
from service.hair.bank import view_camera
from service.hair.beard import Beard, beard_cards, grow_beard
from service.hair.scalp import Scalp, length_of
from service.head.files import load_head
from service.photo.photo import Photo
from tests.support.hair import fit_of

HEAD = load_head()
SCALP = Scalp.of(HEAD)
SKIN_CODE, BEARD_CODE = 190, 50
SIZE = 512


def photographed(yaw: float = 0.0, hangs_m: float = 0.0, code: int = BEARD_CODE) -> tuple[Photo, Fit, Reading]:
    """The mean head with a full beard, which hangs below the chin, as a perfect reader sees it."""
    seen = view_camera(yaw, 0.0)
    factor = SIZE / seen.width
    camera = dataclasses.replace(
        seen, width=SIZE, height=SIZE, focal_px=seen.focal_px * factor, principal_point=seen.principal_point * factor
    )
    fit = fit_of(HEAD.mean, camera)
    region = Region(SIZE / 2, SIZE / 2, SIZE)
    at = region.to_crop(camera.project(HEAD.mean), PART_CELLS)
    drawn = rasterise(at, camera.to_camera(HEAD.mean)[:, 2], HEAD.triangles, PART_CELLS, PART_CELLS, cull=True)
    zone = HEAD.region("beard") * (HEAD.region("lips") < 0.1)
    value = (zone[HEAD.triangles[drawn.triangle]] * drawn.barycentric).sum(-1) * drawn.mask
    bearded = value > 0.5
    if hangs_m:
        chin = HEAD.mean[np.flatnonzero(HEAD.region("chin") > 0.5)]
        middle = chin[chin[:, 1].argmin()]
        corners = middle + np.array([[-0.03, 0.01, 0], [0.03, 0.01, 0], [0.03, -hangs_m, 0], [-0.03, -hangs_m, 0]])
        (left, top), (right, low) = (lambda flat: (flat.min(0), flat.max(0)))(
            region.to_crop(camera.project(corners), PART_CELLS)
        )
        bearded[int(top) : int(low), int(left) : int(right)] = True
    parts = np.zeros((PART_CELLS, PART_CELLS, len(PARTS)), np.float32)
    parts[..., BACKGROUND] = ~drawn.mask & ~bearded
    parts[..., SKIN], parts[..., BEARD] = drawn.mask & ~bearded, bearded
    pixels = np.where(bearded, code, SKIN_CODE).astype(np.uint8).repeat(4, 0).repeat(4, 1)
    photo = Photo(np.stack([pixels, pixels - pixels // 4, pixels - pixels // 3], -1), sha256="0" * 64)
    none = np.zeros((64, 64))
    reading = Reading(region, np.zeros((64, 64, 2)), none, np.zeros((64, 64, 3)), none, parts)
    return photo, fit, reading


def grown(photo: Photo, fit: Fit, reading: Reading) -> Beard:
    made = grow_beard(photo, HEAD, fit, reading, SCALP, 5000, 0)
    assert made is not None
    return made


def test_strands_grow_on_the_bearded_skin_alone_and_stay_out_of_the_head() -> None:
    """Would break where the lips or the neck took strands, or long ones ran through the chin."""
    beard = grown(*photographed(hangs_m=0.05))
    roots, strands = beard.groom.strands[:, 0], beard.groom.strands
    zone = HEAD.mean[HEAD.region("beard") > 0.02]
    apart = np.linalg.norm(roots[:, None] - zone, axis=2).min(1)
    assert apart.max() < 0.01 and np.isfinite(strands).all() and beard.groom.colour.measured
    assert (SCALP.outside(strands[:, 3:]) < -0.003).mean() < 0.02
    # Darker than the skin, and browner than grey, as the photo shows it.
    red, _, blue = np.median(beard.groom.colour.linear().reshape(-1, 3), 0)
    assert blue < red < 0.1


@pytest.mark.parametrize("hangs_mm", [0, 40, 80])
def test_a_beard_is_as_long_as_it_hangs(hangs_mm: int) -> None:
    beard = grown(*photographed(hangs_m=hangs_mm / 1000))
    length = 1000 * length_of(beard.groom.strands)
    longest = float(np.quantile(length, 0.9))
    assert longest < 12 if not hangs_mm else 0.6 * hangs_mm < longest < 1.6 * hangs_mm
    lowest = 1000 * (beard.groom.strands[..., 1].min() - HEAD.mean[HEAD.region("chin") > 0.5][:, 1].min())
    assert lowest > -1.4 * hangs_mm - 8


def test_an_unseen_cheek_has_the_beard_of_the_other() -> None:
    """From the side, one cheek is hidden; would break where only what the photo shows grew."""
    x = grown(*photographed(yaw=50.0)).groom.strands[:, 0, 0]
    left, right = int((x > 0.03).sum()), int((x < -0.03).sum())
    assert min(left, right) > 0.6 * max(left, right)


def test_a_beard_that_reaches_the_ears_goes_on_to_the_hair() -> None:
    """The reader knows no sideburns: between beard and hair lay a bare strip. A goatee has none."""
    photo, fit, reading = photographed(yaw=50.0)
    assert (grown(photo, fit, reading).groom.strands[:, 0, 1] > -0.02).sum() > 20
    made = goatee_of(photo, fit, reading)
    assert made is None or (made.groom.strands[:, 0, 1] > -0.02).sum() == 0


def goatee_of(photo: Photo, fit: Fit, reading: Reading) -> Beard | None:
    """Of the same photo with no beard beside the chin."""
    goatee = reading.parts.copy()
    at = reading.region.to_crop(fit.camera.project(HEAD.mean[HEAD.region("chin") > 0.5]), PART_CELLS)
    beside = np.ones((PART_CELLS, PART_CELLS), np.bool_)
    beside[:, int(at[:, 0].min()) - 8 : int(at[:, 0].max()) + 8] = False
    goatee[beside, BEARD] = 0
    return grow_beard(photo, HEAD, fit, dataclasses.replace(reading, parts=goatee), SCALP, 5000, 0)


def test_a_beard_goes_on_along_the_jaw_that_no_photo_shows_and_a_goatee_does_not() -> None:
    """From the front, strands ended where the jaw turns away, and a dark patch of the completed skin went on."""
    photo, fit, reading = photographed()
    assert (grown(photo, fit, reading).groom.strands[:, 0, 2] < -0.03).sum() > 500
    made = goatee_of(photo, fit, reading)
    assert made is not None and not (made.groom.strands[:, 0, 2] < -0.03).any()


def test_shade_and_stubble_grow_no_strands() -> None:
    """What is no darker than the skin beside it is not known for a beard unless there is much of it."""
    photo, fit, reading = photographed(code=SKIN_CODE - 20)
    few = reading.parts.copy()
    few[:, : PART_CELLS // 2 + 6, BEARD] = 0
    assert grow_beard(photo, HEAD, fit, dataclasses.replace(reading, parts=few), SCALP, 5000, 0) is None
    dark, *_ = photographed()
    assert grow_beard(dark, HEAD, fit, dataclasses.replace(reading, parts=few), SCALP, 5000, 0) is not None


def test_no_beard_where_none_is_read_or_the_head_knows_of_none() -> None:
    photo, fit, reading = photographed()
    none = reading.parts.copy()
    none[..., SKIN] += none[..., BEARD]
    none[..., BEARD] = 0
    assert grow_beard(photo, HEAD, fit, dataclasses.replace(reading, parts=none), SCALP, 5000, 0) is None
    assert grow_beard(photo, HEAD, fit, None, SCALP, 5000, 0) is None
    named = tuple("other" if name == "beard" else name for name in HEAD.region_names)
    assert grow_beard(photo, dataclasses.replace(HEAD, region_names=named), fit, reading, SCALP, 5000, 0) is None


@pytest.mark.parametrize("cells", [2, 4, 8, 14, 28])
def test_a_tuft_is_a_small_beard_or_none(cells: int) -> None:
    """Long, and on little skin: places for its roots were sought without end, or its cards had no triangle left."""
    photo, fit, reading = photographed(hangs_m=0.05)
    few = np.zeros_like(reading.parts)
    few[..., SKIN] = 1
    at = reading.region.to_crop(fit.camera.project(HEAD.mean[HEAD.region("chin") > 0.5]), PART_CELLS).mean(0)
    tuft = slice(int(at[1]) - cells // 2, None), slice(int(at[0]) - cells // 2, int(at[0]) + cells // 2)
    few[*tuft, BEARD], few[*tuft, SKIN] = 1, 0
    made = grow_beard(photo, HEAD, fit, dataclasses.replace(reading, parts=few), SCALP, 5000, 0)
    parts = beard_cards(made, HEAD, fit, "draft", 0)
    assert bool(parts) == (made is not None) == (cells >= 8), cells
    assert all(len(part.faces) for part in parts)


def test_cards_follow_the_jaw() -> None:
    """As far as the skin below them, in all units; would break where a strand hung on the other lip."""
    photo, fit, reading = photographed()
    opened = HEAD.mean + 0.7 * HEAD.expression[list(HEAD.expression_names).index("jawOpen")]
    beard = grown(photo, fit, reading)
    parts = beard_cards(beard, HEAD, dataclasses.replace(fit, vertices=opened), "draft", 0)
    assert [part.name for part in parts] == ["beard", "beard_edge"]
    assert sum(len(part.faces) for part in parts) <= 10_000
    for part in parts:
        target = part.targets["jawOpen"]
        assert np.abs(part.neutral + 0.7 * target - part.vertices).max() < 0.0005
        chin = nearest_offset(part.neutral)
        low = part.neutral[:, 1] < -0.095
        assert np.linalg.norm(target[low] - chin[low], axis=1).mean() < 0.003
        assert part.normals is not None and not any(one.any() for one in part.turned.values())


def nearest_offset(points: Float32) -> Float32:
    """(N, 3) how the skin nearest to points (N, 3) moves as the jaw opens."""
    own = np.flatnonzero(HEAD.region("beard") > 0.02)
    near = own[np.linalg.norm(points[:, None] - HEAD.mean[own], axis=2).argmin(1)]
    return np.asarray(HEAD.expression[list(HEAD.expression_names).index("jawOpen")][near], np.float32)


def test_bytes_repeat() -> None:
    one, two = (grown(*photographed(hangs_m=0.03)) for _ in range(2))
    assert np.array_equal(one.groom.strands, two.groom.strands)
    assert np.array_equal(one.groom.colour.linear(), two.groom.colour.linear())
