"""Colours of hair: measured robustly, and carried by the texture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.anatomy.hair.find_hair import well_within
from service.anatomy.hair.hair_colour import (
    CONTRAST,
    DARKEST,
    LEAST_PIXELS,
    as_melanin,
    guessed,
    hair_picture,
    lifted,
    measure_hair,
)
from service.anatomy.hair.wearables import read_items
from service.anatomy.hair.worn import to_albedo
from service.colour import linear_to_srgb, luma, srgb_to_linear

BROWN = np.array([0.08, 0.045, 0.02])


def strands(colour: np.ndarray, count: int = 400, spread: float = 0.3) -> np.ndarray:
    light = np.exp(np.random.default_rng(1).normal(0, spread, (count, 1)))
    return (colour * light).astype(np.float32)


def test_the_hue_survives_a_tenth_of_wrong_pixels() -> None:
    pixels = strands(BROWN)
    pixels[:40] = [0.9, 0.95, 1.0]  # sky between strands
    found = measure_hair(pixels, np.zeros(len(pixels), np.float32), np.ones(len(pixels), bool))
    assert found is not None and found.measured
    np.testing.assert_allclose(found.usual / luma(found.usual), BROWN / luma(BROWN.astype(np.float32)), rtol=0.03)
    assert 0.7 < float(luma(found.usual) / luma(BROWN.astype(np.float32))) < 1.4
    assert found.grey == 0.0 and found.sheen > 1.0


def test_contrast_stays_within_what_hair_has() -> None:
    for spread in (0.0, 2.0):
        found = measure_hair(strands(BROWN, spread=spread), np.zeros(400, np.float32), np.ones(400, bool))
        assert found is not None
        ratio = float(luma(found.lit) / luma(found.shaded))
        assert CONTRAST[0] - 0.01 <= ratio <= CONTRAST[1] + 0.01


def test_bleached_tips_are_told_from_roots() -> None:
    along = np.linspace(0.01, 1, 400).astype(np.float32)
    pixels = strands(BROWN, spread=0.1) * (1 + along[:, None])
    found = measure_hair(pixels, along, np.ones(400, bool))
    assert found is not None and (found.tip > 1.1).all() and (found.root < 0.95).all()


def test_grey_hair_is_grey() -> None:
    found = measure_hair(strands(np.array([0.3, 0.29, 0.28])), np.zeros(400, np.float32), np.ones(400, bool))
    assert found is not None and found.grey == 1.0


def test_black_hair_that_mirrors_a_window_is_not_violet() -> None:
    """Measured on a portrait in warm light: black strands show the sky, and the light on the skin is taken off them."""
    light = np.array([0.74, 0.79, 1.14], np.float32)
    found = measure_hair(strands(np.array([0.035, 0.020, 0.0172])), np.zeros(400, np.float32), np.ones(400, bool))
    assert found is not None
    before, after = found.usual * light, found.natural(light).usual * light
    assert before[2] > before[1] and (np.diff(after) < 1e-6).all() and after[2] > 0
    assert float(luma(after)) == pytest.approx(float(luma(before)), rel=1e-3)


@pytest.mark.parametrize("colour", [(0.4, 0.2, 0.08), (0.05, 0.1, 0.3), (0.3, 0.29, 0.28), (0.0, 0.0, 0.0)])
def test_natural_and_dyed_hair_keep_their_colour(colour: tuple[float, float, float]) -> None:
    assert as_melanin(np.array(colour, np.float32)) == pytest.approx(np.array(colour), abs=1e-6)


def test_channels_in_the_wrong_order_meet() -> None:
    for wrong in ((0.2, 0.25, 0.3), (0.2, 0.3, 0.25), (0.25, 0.2, 0.3)):
        made = as_melanin(np.array(wrong, np.float32))
        assert made[0] > 1.1 * made[1] and made[1] > 1.1 * made[2], "equal red and green would be olive"
        assert float(luma(made)) == pytest.approx(float(luma(np.array(wrong, np.float32))), rel=1e-3)


def test_too_little_hair_gives_no_colour() -> None:
    few = strands(BROWN, LEAST_PIXELS - 1)
    assert measure_hair(few, np.zeros(len(few), np.float32), np.ones(len(few), bool)) is None
    assert measure_hair(few[:0], np.zeros(0, np.float32), np.zeros(0, bool)) is None
    assert not guessed(np.full(3, 0.4, np.float32)).measured


@pytest.mark.parametrize("name", ["hair/short02", "hair/long01"])
def test_the_texture_has_the_colour_of_the_hair(name: str) -> None:
    item = read_items().items[name]
    found = measure_hair(strands(BROWN), np.zeros(400, np.float32), np.ones(400, bool))
    assert found is not None
    light = np.array([1.5, 1.2, 1.0], np.float32)
    picture = hair_picture(item, found, light)
    assert picture.shape == (512, 512, 4) and picture.dtype == np.uint8
    assert (picture[..., 3] <= item.picture[..., 1]).all()
    solid = srgb_to_linear(picture[picture[..., 3] > 200][:, :3] / np.float32(255))
    mean = np.median(solid, 0)
    np.testing.assert_allclose(mean / luma(mean), found.usual * light / luma(found.usual * light), rtol=0.08)
    assert 0.6 < float(luma(mean) / luma(found.usual * light)) < 1.6


def test_the_photos_light_is_the_ratio_on_lit_skin() -> None:
    rng = np.random.default_rng(2)
    albedo = rng.uniform(0.3, 0.6, (20, 20, 3)).astype(np.float32)
    light = np.array([0.8, 0.7, 0.5], np.float32)
    coded = [np.rint(255 * linear_to_srgb(x)).astype(np.uint8) for x in (albedo, albedo * light)]
    lit = np.full((20, 20), 255, np.uint8)
    coded[1][:5] = 3  # hair, which is not lit skin
    lit[:5] = 0
    np.testing.assert_allclose(to_albedo(coded[1], coded[0], lit), 1 / light, rtol=0.02)
    assert np.array_equal(to_albedo(coded[1], coded[0], np.zeros_like(lit)), np.ones(3))


def test_black_hair_is_no_hole_and_bright_hair_stays() -> None:
    crushed = np.array([4e-4, 1e-4, 0.0], np.float32)
    shaded, lit = lifted(crushed, 2 * crushed)
    assert 0.7 * DARKEST < luma(0.5 * (shaded + lit)) < 1.5 * DARKEST
    assert (lit > shaded).all() and lit[2] > 0.5 * lit[0], "the cast that took the blue away is not the hair's"
    brown = np.array([0.05, 0.03, 0.02], np.float32)
    same = lifted(brown, 2 * brown)
    np.testing.assert_array_equal(same, (brown, 2 * brown))


def test_a_dark_texture_has_no_edges_where_its_levels_change() -> None:
    """A third of the texels of a dark style have one level of grey: its border was an edge through the hair."""
    item = read_items().items["hair/braid01"]
    found = measure_hair(strands(BROWN), np.zeros(400, np.float32), np.ones(400, bool))
    assert found is not None
    picture = hair_picture(item, found, np.ones(3, np.float32))[..., 0].astype(float)
    grey, solid = item.picture[..., 0].astype(int), item.picture[..., 1] > 200
    common = int(np.bincount(grey[solid]).argmax())
    border = (solid[:, 1:] & solid[:, :-1]) & (np.maximum(grey[:, 1:], grey[:, :-1]) == common)
    border &= np.abs(np.diff(grey, axis=1)) == 1
    jumps = np.abs(np.diff(picture, axis=1))[border]
    assert len(jumps) > 100 and np.median(jumps) < 0.1 * np.ptp(picture[solid])


def test_cells_at_the_border_of_hair_give_no_colour() -> None:
    """What lies behind shines through them: fair hair before a blue wall had lilac roots."""
    certain = np.zeros((40, 40), bool)
    certain[5:35, 5:30] = True
    inner = well_within(certain)
    assert inner[7:33, 7:28].all() and inner.sum() == 26 * 21
    thin = np.zeros((40, 40), bool)
    thin[5:8] = True
    assert np.array_equal(well_within(thin), thin), "all of it is border"


def test_shaded_and_lit_strands_are_quarters_of_the_picture_and_not_its_extremes() -> None:
    """Between them alone, hair had half of the photo's contrast and looked flat."""
    item = read_items().items["hair/short02"]
    shaded, lit = (factor * BROWN.astype(np.float32) for factor in (np.float32(1), np.float32(2.4)))
    colour = replace(guessed(np.array([0.5, 0.33, 0.25], np.float32)), shaded=shaded, lit=lit)
    picture = hair_picture(item, colour, np.ones(3, np.float32))
    bright = luma(srgb_to_linear(picture[picture[..., 3] > 200][:, :3] / np.float32(255)))
    dark, low, high, top = np.quantile(bright, [0.05, 0.25, 0.75, 0.95])
    ends = luma(np.stack([BROWN, 2.4 * BROWN]))
    assert low == pytest.approx(ends[0], rel=0.3) and high == pytest.approx(ends[1], rel=0.3)
    assert top / dark > 1.2 * 2.4
