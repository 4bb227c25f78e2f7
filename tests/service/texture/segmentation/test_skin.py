"""Portraits whose parts are known: what is skin, and what of it tells the light, follows from them and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial import cKDTree

from service.face.reading.part_labels import BEARD, BROW, CLOTH, GLASSES, HAT, IRIS, OTHER, PARTS, SKIN
from service.geometry.chart import Chart
from service.head.files import load_head
from service.map_registry import SEEN
from service.texture.segmentation import Zones, parts_at, segment, worn_before
from service.texture.texture import make_texture
from service.texture.texture_maps import Texture
from service.texture.unwrap import unwrap
from tests.service.texture.scenes import SKIN as TONE
from tests.service.texture.scenes import fitted, photograph, plain, read_off, turned

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Where = Callable[[Array], Mask]

HEAD = load_head(None)
CHART = Chart.build(HEAD, 288, 192)
ZONES = Zones.of(CHART)
CAMERA = turned(0.0, 500)
FIT = fitted(HEAD, CAMERA)
POINTS = CHART.interpolate(HEAD.mean).astype(float)
SKIN_PART = HEAD.part_names.index("skin")
OWN = (CHART.part == SKIN_PART) & CHART.mask
EYE_Y = float(HEAD.mean[HEAD.region("eyelid_left") > 0.5, 1].mean())
MOUTH_Y = float(HEAD.mean[HEAD.region("lips") > 0.5, 1].mean())
BLACK = (0.06, 0.05, 0.05)


def chin(points: Array) -> Mask:
    return np.asarray((points[:, 1] < MOUTH_Y + 0.004) & (points[:, 1] > MOUTH_Y - 0.05) & (points[:, 2] > 0.0))


def forehead(points: Array) -> Mask:
    return np.asarray(points[:, 1] > EYE_Y + 0.03)


def frame(points: Array) -> Mask:
    return np.asarray((np.abs(points[:, 1] - EYE_Y) < 0.016) & (points[:, 2] > 0.0))


def everything(points: Array) -> Mask:
    return np.ones(len(points), bool)


def made(where: Where, colour: tuple[float, float, float], part: int) -> Texture:
    """The texture of a head of which a place has a colour and is a part; all else is skin."""
    photo = photograph(HEAD, CAMERA, lambda p: np.where(where(p)[:, None], colour, TONE))
    return make_texture(photo, HEAD, FIT, CHART, read_off(HEAD, CAMERA, lambda p: np.where(where(p), part, SKIN)))


def inner(where: Where, texels: int = 4) -> Mask:
    """Texels well inside a place, or with negative ``texels`` well outside of it."""
    found = where(POINTS.reshape(-1, 3)).reshape(CHART.mask.shape)
    found = found if texels > 0 else ~found
    smaller = cv2.erode(found.astype(np.uint8), np.ones((2 * abs(texels) + 1,) * 2, np.uint8))
    return np.asarray(OWN & (np.asarray(smaller) > 0))


@cache
def bare_face() -> tuple[Texture, Mask]:
    """The texture of a bare face, and the texels of skin that the photo shows well."""
    bare = made(everything, TONE, SKIN)
    return bare, np.asarray(OWN & (bare.confidence > 200) & (bare.lit_skin > 250))


@pytest.mark.parametrize("part", [BEARD, BROW])
def test_hair_on_the_face_is_seen_and_kept_and_no_light_is_read_from_it(part: int) -> None:
    """Left out it would be replaced by skin; taken for lit skin its darkness would be taken for shade."""
    texture = made(chin, BLACK, part)
    hair, bare = inner(chin) & bare_face()[1], inner(chin, -8) & bare_face()[1]
    assert hair.sum() > 150 and bare.sum() > 1000
    assert (texture.confidence[hair] >= SEEN).all() and (texture.lit_skin[hair] < 5).all()
    assert np.abs(texture.texture[hair] / 255 - BLACK).max() < 0.03
    assert (texture.lit_skin[bare] > 250).all() and texture.warnings == ()


@pytest.mark.parametrize("part", [HAT, OTHER, CLOTH])
@pytest.mark.parametrize("colour", [(0.45, 0.6, 0.95), TONE], ids=["blue", "like skin"])
def test_what_is_worn_is_not_seen_whatever_its_colour(part: int, colour: tuple[float, float, float]) -> None:
    """A cap of the colour of skin would be a forehead, a blue one would make the light blue."""
    texture = made(forehead, colour, part)
    hidden = inner(forehead) & bare_face()[1]
    assert hidden.sum() > 500
    assert (texture.confidence[hidden] < SEEN).all() and (texture.lit_skin[hidden] < 5).all()
    assert np.abs(texture.texture[hidden] / 255 - TONE).max() < 0.06
    assert texture.warnings == ("face-covered",)


def test_a_frame_is_taken_off_and_the_archive_says_so() -> None:
    texture = made(frame, BLACK, GLASSES)
    worn = inner(frame, 2) & bare_face()[1]
    assert worn.sum() > 50 and "glasses-removed" in texture.warnings
    off = np.abs(texture.texture[worn] / 255 - TONE).max(1)
    assert (texture.confidence[worn] < SEEN).all() and np.median(off) < 0.05 and off.max() < 0.2, "0.74 with it left in"


@pytest.mark.parametrize("colour", [(0.2, 0.3, 0.8), (0.5, 0.5, 0.5), (0.02, 0.02, 0.02), (1.0, 1.0, 1.0)])
def test_skin_of_any_colour_is_skin(colour: tuple[float, float, float]) -> None:
    """Face paint, a grey photo, clipped shadows and clipped lights: no rule about colours leaves any of it out."""
    texture, usual = made(everything, colour, SKIN), bare_face()[0]
    assert np.array_equal(texture.lit_skin, usual.lit_skin) and np.array_equal(texture.confidence, usual.confidence)


def test_the_colour_of_the_skin_is_that_of_bare_skin() -> None:
    """Far from all that is seen it is the skin's: with the beard in it a bearded man's neck would be grey."""

    def paint(points: Array) -> Array:
        return np.where(chin(points)[:, None], BLACK, TONE)

    reading = read_off(HEAD, CAMERA, lambda p: np.where(chin(p), BEARD, SKIN))
    unwrapped = unwrap(photograph(HEAD, CAMERA, paint), FIT, CHART)
    found = segment(CHART, unwrapped, parts_at(reading, FIT, unwrapped), ZONES)
    assert found.colour is not None and np.abs(found.colour - TONE).max() < 0.02
    nothing = segment(CHART, unwrapped, np.zeros((len(unwrapped.weight), len(PARTS)), np.float32), ZONES)
    assert nothing.colour is None and not nothing.lit.any()


def test_eyes_are_the_photo_s_where_it_shows_eyes() -> None:
    """Where lids or lenses are in their place, skin would be printed on the eyeball."""
    eyes = np.isin(CHART.part, [i for i, name in enumerate(HEAD.part_names) if name.startswith("eye")]) & CHART.mask
    photo = photograph(HEAD, CAMERA, plain((0.9, 0.1, 0.9)))
    shut, wide = (
        make_texture(photo, HEAD, FIT, CHART, read_off(HEAD, CAMERA, lambda p: np.full(len(p), part)))  # noqa: B023
        for part in (SKIN, IRIS)
    )
    assert not (shut.confidence[eyes] >= SEEN).any() and (wide.confidence[eyes] >= SEEN).sum() > 20


def test_without_a_reading_the_face_is_taken_from_the_photo_and_nothing_else() -> None:
    """Hair, collar and wall cannot be told: painted on scalp and neck they would be tattoos."""

    nearest = cKDTree(HEAD.mean[HEAD.triangles[HEAD.triangle_part == SKIN_PART].ravel()])
    mask = HEAD.region("face")[HEAD.triangles[HEAD.triangle_part == SKIN_PART].ravel()]

    def paint(points: Array) -> Array:
        return np.where(mask[nearest.query(points)[1]][:, None] < 0.1, (0.1, 0.2, 0.9), TONE)

    texture = make_texture(photograph(HEAD, CAMERA, paint), HEAD, FIT, CHART)
    assert texture.warnings == ("not-segmented",)
    zone = np.zeros(CHART.mask.shape, np.float32)
    zone.ravel()[CHART.texels] = ZONES.face
    assert (texture.confidence[OWN & (zone < 0.3)] < SEEN).all()
    assert (texture.confidence[OWN & (zone > 0.9)] >= SEEN).mean() > 0.6
    blue = texture.texture[..., 2].astype(int) - texture.texture[..., 0]
    assert blue[OWN].max() < 0


def test_nothing_shown_is_worth_no_warning() -> None:
    """Shares of a face of no texels."""
    count = len(ZONES.skin)
    assert worn_before(np.ones((count, len(PARTS)), np.float32), np.zeros(count, np.float32), ZONES) == ()
