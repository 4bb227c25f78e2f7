"""What of the chart the photo shows."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial import cKDTree

from service.face.reading.part_labels import (
    BACKGROUND,
    BROW,
    CLOTH,
    GLASSES,
    HAIR,
    HAT,
    OTHER,
    PARTS,
    SCLERA,
    SKIN,
)
from service.face.reading.reader import CELLS, PART_CELLS, Reading
from service.face.region import Region
from service.geometry.chart import Chart
from service.head.files import load_head
from service.map_registry import SEEN
from service.texture.part_colours import brightest_cloth
from service.texture.texture import Texture, make_texture
from service.texture.unwrap import Zones, behind_glasses, covered, mirrored_by_lenses, parts_at, segment, unwrap
from tests.service.texture.scenes import SKIN as TONE
from tests.service.texture.scenes import fitted, photograph, plain, read_off, turned

HEAD = load_head(None)
CHART = Chart.build(HEAD, 288, 192)
CAMERA = turned(0.0)
FIT = fitted(HEAD, CAMERA)


def reading(part: int, left_half: bool = True) -> Reading:
    """All is skin, but one half of the picture (or all of it) shows ``part``."""
    parts = np.zeros((PART_CELLS, PART_CELLS, len(PARTS)), np.float32)
    parts[..., SKIN] = 1
    where = slice(0, PART_CELLS // 2) if left_half else slice(None)
    parts[:, where] = np.eye(len(PARTS), dtype=np.float32)[part]
    grid = np.ones((CELLS, CELLS))
    return Reading(Region(200, 200, 400), np.zeros((CELLS, CELLS, 2)), grid, np.zeros((CELLS, CELLS, 3)), grid, parts)


@pytest.mark.parametrize("part", [BACKGROUND, GLASSES, HAT, CLOTH, OTHER, HAIR])
def test_the_part_hides_its_half_and_no_more(part: int) -> None:
    """One pixel off, or x and y exchanged, and the border would not lie in the middle of the face."""
    unwrapped, zones = unwrap(photograph(HEAD, CAMERA, plain(TONE)), FIT, CHART), Zones.of(CHART)
    parts = parts_at(reading(part), FIT, unwrapped)
    hidden = behind_glasses(CHART, unwrapped, parts, 0 * parts[:, 0]) if part == GLASSES else covered(parts, zones)
    shown = (unwrapped.weight > 0) & (zones.scalp == 0)
    x, margin = CAMERA.project(unwrapped.position)[:, 0], 30 * (part == GLASSES)  # with their shade
    assert (hidden[shown & (x < 195 - margin)] > 0.99).all() and (hidden[shown & (x > 205 + margin)] < 0.01).all()
    assert part == GLASSES or (hidden[unwrapped.weight == 0] == 0).all()


def test_brows_and_lids_are_seen_through_glasses() -> None:
    """Brows and eyes of those who wear glasses were completed as if they had none."""
    unwrapped, zones = unwrap(photograph(HEAD, CAMERA, plain(TONE)), FIT, CHART), Zones.of(CHART)
    shown, none = unwrapped.weight > 0, np.zeros(len(unwrapped.weight), np.float32)
    place = unwrapped.position
    brow = shown & (np.abs(place[:, 1] - 0.02) < 0.004) & (np.abs(np.abs(place[:, 0]) - 0.032) < 0.012)
    eye = shown & (np.hypot(np.abs(place[:, 0]) - 0.032, place[:, 1]) < 0.006)
    cheek = shown & zones.skin & (np.abs(place[:, 1] + 0.02) < 0.004) & (np.abs(place[:, 0]) < 0.05)
    assert brow.sum() > 20 and eye.sum() > 20 and cheek.sum() > 20
    parts = np.zeros((len(shown), len(PARTS)), np.float32)
    parts[:, SKIN], parts[shown & (place[:, 1] > -0.03) & (place[:, 1] < 0.03), GLASSES] = 0.4, 0.5
    worn = parts.copy()
    worn[brow, BROW], worn[eye, SCLERA] = 0.5, 0.5
    clear, dark = behind_glasses(CHART, unwrapped, worn, none), behind_glasses(CHART, unwrapped, parts, none)
    assert clear[brow].max() < 0.1 and clear[eye].max() < 0.1 < 0.4 < clear[cheek].min()
    assert dark[brow].min() > 0.4 and dark[eye].min() > 0.4, "nothing is seen through dark lenses"
    assert behind_glasses(CHART, unwrapped, worn, np.asarray(cheek, np.float32))[cheek].min() > 0.99


def test_what_lenses_mirror_is_not_the_lids_own() -> None:
    """What lenses mirror, blue, green or white, stayed on the lids as paint. Dark lashes, blue as well, are seen."""
    unwrapped = unwrap(photograph(HEAD, CAMERA, plain(TONE)), FIT, CHART)
    shown, place = unwrapped.weight > 0, unwrapped.position
    parts = np.zeros((len(shown), len(PARTS)), np.float32)
    parts[:, SKIN], parts[shown & (np.abs(place[:, 1]) < 0.004), GLASSES] = 1, 0.4
    lid = shown & (np.hypot(np.abs(place[:, 0]) - 0.032, place[:, 1] - 0.006) < 0.003)
    chin = shown & (np.abs(place[:, 1] + 0.09) < 0.002) & (np.abs(place[:, 0]) < 0.01)
    assert lid.sum() > 10 and chin.sum() > 5
    parts[lid | chin, SKIN] = 0.5
    for colour, hides in (
        (TONE, False),
        ((0.35, 0.6, 0.75), True),
        ((0.3, 0.75, 0.5), True),
        ((1.0, 1.0, 0.98), True),
        ((0.05, 0.06, 0.08), False),
    ):
        image = unwrapped.colour.copy()
        image[lid | chin] = colour
        found = mirrored_by_lenses(CHART, dataclasses.replace(unwrapped, colour=image), parts)
        assert found[lid].min() > 0.9 if hides else found[lid].max() < 0.1
        assert found[chin].max() < 0.1, "far from glasses nothing is mirrored"


def test_the_brightest_tenth_of_a_shirt_tells_the_light() -> None:
    """A blown button is no shirt, and a few cells of cloth are none, either."""
    photo = photograph(HEAD, CAMERA, plain(TONE))
    pixels = np.full_like(photo.pixels, 188)
    pixels[:8, :8] = 255
    worn, shown = reading(CLOTH), dataclasses.replace(photo, pixels=pixels)
    assert brightest_cloth(shown, worn) == pytest.approx(0.503, abs=0.01)
    scraps = worn.parts.copy()
    scraps[4:, :, CLOTH] = 0
    scraps[:, 4:, CLOTH] = 0
    assert brightest_cloth(shown, dataclasses.replace(worn, parts=scraps)) == 0


def test_hair_on_the_scalp_is_the_head_s_own() -> None:
    unwrapped, zones = unwrap(photograph(HEAD, CAMERA, plain(TONE)), FIT, CHART), Zones.of(CHART)
    hidden = covered(parts_at(reading(HAIR, left_half=False), FIT, unwrapped), zones)
    assert (hidden[zones.scalp > 0.99] == 0).all()
    assert (hidden[(unwrapped.weight > 0) & (zones.scalp == 0)] == 1).all()


def test_a_hand_of_the_colour_of_skin_is_not_kept() -> None:
    """Colours cannot tell it from the face: only the reader does."""

    def half_red(points: np.ndarray) -> np.ndarray:
        return np.where(points[:, :1] < 0, np.array([[0.85, 0.6, 0.5]]), np.array([[*TONE]]))

    photo = photograph(HEAD, CAMERA, half_red)
    without = make_texture(photo, FIT, CHART)
    with_it = make_texture(photo, FIT, CHART, reading=reading(OTHER))
    # The seen half is mirrored into the other: red goes.
    cheek = np.s_[85:100, 110:125]
    assert with_it.texture[cheek][..., 0].mean() < without.texture[cheek][..., 0].mean() - 5
    assert with_it.visible_fraction < without.visible_fraction


@pytest.mark.parametrize(("share", "long", "kept"), [(0.006, 3, False), (0.03, 3, True), (0.02, 24, False)])
def test_a_sliver_of_neck_between_jaw_and_collar_is_not_taken(share: float, long: int, kept: bool) -> None:
    """Jaw and collar throw their shade on it: it would leave two stains on the throat. A face may be in pieces."""
    unwrapped, zones = unwrap(photograph(HEAD, CAMERA, plain(TONE)), FIT, CHART), Zones.of(CHART)
    row, column = np.divmod(CHART.texels, CHART.width)
    middle = int(np.median(row[(zones.beside > 0.99) & (np.abs(column - CHART.width / 2) < 3)]))
    half = np.sqrt(share * CHART.width * CHART.height / long) / 2
    neck = zones.skin & (np.abs(row - middle) <= half) & (np.abs(column - CHART.width / 2) <= long * half)
    cheek = (zones.face > 0.9) & zones.skin & (np.abs(column - 0.6 * CHART.width) < 2)
    weight = np.where(neck | cheek, np.float32(1), np.float32(0))
    parts = np.zeros((len(weight), len(PARTS)), np.float32)
    parts[:, SKIN] = 1
    seen = segment(CHART, replace(unwrapped, weight=weight), parts, zones).seen
    assert (seen[neck & (zones.face < 0.01)].mean() > 0.5) == kept
    assert seen[cheek & (zones.hidden == 0)].mean() > 0.9


def test_everything_hidden_still_gives_a_head() -> None:
    """No texel is seen: means over nothing must not become NaN."""
    texture = make_texture(photograph(HEAD, CAMERA, plain(TONE)), FIT, CHART, reading=reading(HAT, False))
    assert np.isfinite(texture.shape_normal_object).all() and "little-seen" in texture.warnings


Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Where = Callable[[Array], Mask]

ZONES = Zones.of(CHART)
FRONT = turned(0.0, 500)
FRONT_FIT = fitted(HEAD, FRONT)
POINTS = CHART.interpolate(HEAD.mean).astype(float)
SKIN_PART = HEAD.part_names.index("skin")
OWN = (CHART.part == SKIN_PART) & CHART.mask
EYE_Y = float(HEAD.mean[HEAD.region("eyelid_left") > 0.5, 1].mean())
BLACK = (0.06, 0.05, 0.05)


def frame(points: Array) -> Mask:
    return np.asarray((np.abs(points[:, 1] - EYE_Y) < 0.016) & (points[:, 2] > 0.0))


def everything(points: Array) -> Mask:
    return np.ones(len(points), bool)


def made(where: Where, colour: tuple[float, float, float], part: int) -> Texture:
    """The texture of a head of which a place has a colour and is a part; all else is skin."""
    photo = photograph(HEAD, FRONT, lambda p: np.where(where(p)[:, None], colour, TONE))
    return make_texture(photo, FRONT_FIT, CHART, read_off(HEAD, FRONT, lambda p: np.where(where(p), part, SKIN)))


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


def test_a_frame_is_taken_off_and_the_archive_says_so() -> None:
    texture = made(frame, BLACK, GLASSES)
    worn = inner(frame, 2) & bare_face()[1]
    assert worn.sum() > 50 and "glasses-removed" in texture.warnings
    off = np.abs(texture.texture[worn] / 255 - TONE).max(1)
    assert (texture.confidence[worn] < SEEN).all() and np.median(off) < 0.05 and off.max() < 0.2, "0.74 with it left in"


def test_without_a_reading_the_face_is_taken_from_the_photo_and_nothing_else() -> None:
    """Hair, collar and wall cannot be told: painted on scalp and neck they would be tattoos."""

    nearest = cKDTree(HEAD.mean[HEAD.triangles[HEAD.triangle_part == SKIN_PART].ravel()])
    mask = HEAD.region("face")[HEAD.triangles[HEAD.triangle_part == SKIN_PART].ravel()]

    def paint(points: Array) -> Array:
        return np.where(mask[nearest.query(points)[1]][:, None] < 0.1, (0.1, 0.2, 0.9), TONE)

    texture = make_texture(photograph(HEAD, FRONT, paint), FRONT_FIT, CHART)
    assert texture.warnings == ("not-segmented",)
    zone = np.zeros(CHART.mask.shape, np.float32)
    zone.ravel()[CHART.texels] = ZONES.face
    assert (texture.confidence[OWN & (zone < 0.3)] < SEEN).all()
    assert (texture.confidence[OWN & (zone > 0.9)] >= SEEN).mean() > 0.6
    blue = texture.texture[..., 2].astype(int) - texture.texture[..., 0]
    assert blue[OWN].max() < 0
