"""Eyes in the detail of the map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.anatomy.eye_painting import LEAST_TEXELS, RING, draw_eyes, eyeballs
from service.colour import FULL_CODE, linear_to_srgb
from service.face.features.eye_colours import SCLERA
from service.head.files import load_head

HEAD = load_head()
BROWN, BLUE, WHITE = (0.35, 0.22, 0.14), (0.35, 0.45, 0.60), (0.80, 0.78, 0.76)


def blurred_eyes(size: tuple[int, int], iris: tuple[float, float, float]) -> np.ndarray:
    """Grey codes (H, W, 3) with eyes as an enlarged texture has them: an iris without a pupil, a white around."""
    albedo = np.full((size[1], size[0], 3), 30000, np.uint16)
    for eye in eyeballs(HEAD, size):
        assert eye.place is not None
        colours = np.where(eye.radius[:, None] < 1.02, iris, WHITE)
        albedo[eye.place.box][eye.place.inside] = np.rint(colours * FULL_CODE).astype(np.uint16)
    return albedo


@pytest.mark.parametrize("size", [(1536, 1024), (3072, 2048)])
@pytest.mark.parametrize("iris", [BROWN, BLUE])
def test_eyes_get_pupils_and_fibres_and_keep_their_colours(
    size: tuple[int, int], iris: tuple[float, float, float]
) -> None:
    before = blurred_eyes(size, iris)
    after = draw_eyes(before.copy(), HEAD) / FULL_CODE
    elsewhere = np.ones(after.shape[:2], bool)
    for eye in eyeballs(HEAD, size):
        assert eye.place is not None
        colours, r = after[eye.place.box][eye.place.inside], eye.radius
        ring = colours[(r > RING[0]) & (r < RING[1])]
        assert np.abs(np.median(ring, 0) - iris).max() < 0.08
        assert ring.std(0).max() > 0.02
        assert np.abs(np.median(colours[(r > 1.25) & (r < 1.8)], 0) - linear_to_srgb(SCLERA)).max() < 0.03
        assert colours[r < 0.2].max() < 0.25 * max(iris)
        assert colours.max() < 0.935  # sRGB of the brightest albedo
        elsewhere[eye.place.box] &= ~eye.place.inside
    assert np.array_equal(after[elsewhere] * FULL_CODE, before[elsewhere])


def test_an_iris_is_round_and_of_its_size_on_the_eye() -> None:
    """11.7 mm on a ball of 24 mm: the map is stretched there, and an iris drawn on the map would not be."""
    for eye in eyeballs(HEAD, (3072, 2048)):
        assert np.degrees(np.arcsin(5.85 / 12)) == pytest.approx(eye.limbus, abs=0.6)
        across = 12 * np.hypot(*eye.direction[eye.radius < 1][:, :2].T)
        assert across.max() == pytest.approx(5.85, abs=0.1)


def test_what_tells_no_colours_stays_as_it_is() -> None:
    """Medians of nothing: a map with an eye of few texels, a head without eyes."""
    small = blurred_eyes((96, 64), BROWN)
    assert sum(int((e.radius < 1).sum()) for e in eyeballs(HEAD, (96, 64))) < LEAST_TEXELS
    assert np.array_equal(draw_eyes(small.copy(), HEAD), small)
    blind = replace(HEAD, part_names=tuple(f"other_{i}" for i, _ in enumerate(HEAD.part_names)))
    plain = np.full((64, 96, 3), 30000, np.uint16)
    assert np.array_equal(draw_eyes(plain.copy(), blind), plain)


def test_detail_is_as_strong_as_asked_and_black_eyes_stay_finite() -> None:
    before = blurred_eyes((768, 512), BROWN)
    none, some, full, same = (draw_eyes(before.copy(), HEAD, detail).astype(int) for detail in (0.0, 0.5, 1.0, 1.0))
    assert np.array_equal(full, same)
    assert 0 < np.abs(some - none).mean() < np.abs(full - none).mean()
    dark = draw_eyes(np.zeros_like(before), HEAD)
    assert dark.dtype == np.uint16 and dark[:50].max() == 0
