"""What pigment hair has is told by Bayes' rule: under white light it is found again, and no light makes it absurd."""

from __future__ import annotations

import numpy as np
import pytest

from service.colour import luma
from service.hair import pigment
from service.hair.colour import COLOURS, SHINE, HairColour
from service.hair.pigment import Pigment, told_pigment

WHITE = np.ones(3)


def usual(name: str) -> np.ndarray:
    """(3,) linear RGB of a head of this natural colour."""
    return np.median(HairColour.of(COLOURS[name], 500, np.random.default_rng(0)).linear().reshape(-1, 3), 0)


@pytest.mark.parametrize("name", sorted(COLOURS))
def test_a_natural_colour_is_found_again_under_white_light(name: str) -> None:
    colour = usual(name)
    found = told_pigment(colour + SHINE, WHITE)
    assert found.dyed < 0.5 and (found.grey > 0.5) is (name in ("grey", "white"))
    assert abs(np.log(luma(found.albedo) / luma(colour))) < 0.75, "no farther than an unknown light may move it"
    hue = np.log(found.albedo[0] / found.albedo[1]) - np.log(colour[0] / colour[1])
    assert abs(hue) < 0.25


@pytest.mark.parametrize(
    ("shown", "light", "least", "most"),
    [
        ((0.40, 0.23, 0.10), (2.7, 3.7, 4.7), 0.06, 0.35),  # blond before the sun, its face in shade: it was white
        ((0.058, 0.061, 0.083), (4.6, 5.3, 3.4), 0.003, 0.02),  # black below the sun, the face in shade: it was grey
        ((0.15, 0.10, 0.08), (1.1, 1.4, 2.4), 0.003, 0.03),  # black that mirrors a window: it was light brown
    ],
)
def test_light_behind_the_head_makes_no_hair_fair(
    shown: tuple[float, ...], light: tuple[float, ...], least: float, most: float
) -> None:
    found = told_pigment(np.array(shown), np.array(light))
    assert least < luma(found.albedo) < most and (np.diff(found.albedo) <= 0).all()


def test_dyed_hair_keeps_its_colour() -> None:
    for colour in ((0.02, 0.05, 0.2), (0.4, 0.1, 0.2), (0.05, 0.3, 0.1), (0.1, 0.03, 0.12)):
        found = told_pigment(np.array(colour), WHITE)
        assert found.dyed > 0.5
        np.testing.assert_allclose(found.albedo, colour, rtol=1e-5)


def test_coloured_light_leaves_it_open_whether_hair_is_grey() -> None:
    shown, lamp = np.array([0.267, 0.223, 0.165]), np.array([0.6, 1.0, 1.7])
    plain, doubted = told_pigment(shown, WHITE), told_pigment(shown / lamp, lamp)
    assert plain.grey > 0.6 and doubted.grey < plain.grey - 0.1


def test_who_is_likely_to_be_grey_is_grey_sooner() -> None:
    shown, lamp = np.array([0.062, 0.032, 0.015]), np.array([1.15, 1.96, 2.93])
    assert told_pigment(shown, lamp).grey < 0.3 < 0.5 < told_pigment(shown, lamp, 0.65).grey


def test_heads_enough_are_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    cases = [(usual(name) + SHINE, WHITE) for name in COLOURS]
    many = [told_pigment(*case).albedo for case in cases]
    pigment._heads.cache_clear()
    monkeypatch.setattr(pigment, "HEADS", pigment.HEADS // 2)
    try:
        few = [told_pigment(*case).albedo for case in cases]
    finally:
        pigment._heads.cache_clear()
    np.testing.assert_allclose(few, many, rtol=0.06)


@pytest.mark.parametrize("shown", [0.0, 1.0])
@pytest.mark.parametrize("light", [0.0, 1.0, 1e9])
def test_black_and_white_pixels_and_no_light_give_a_colour(shown: float, light: float) -> None:
    """Logarithms of 0 would be infinite."""
    for red in (shown, 0.5):
        found: Pigment = told_pigment(np.array([red, shown, shown]), np.array([light, light, 1.0]))
        assert np.isfinite([*found.albedo, found.grey, found.dyed]).all()
        assert (found.albedo > 0).all() and (found.albedo < 1).all()
