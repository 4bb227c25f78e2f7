"""Graded photos: hues that follow the light go to the light; those of plain photos stay."""

from __future__ import annotations

import numpy as np
import pytest

from service.reflectance.corrections.grading import MOST, USUAL, even_hue
from service.reflectance.corrections.skin_hue import FEW

SKIN = np.array([0.45, 0.25, 0.18], np.float32)[:, None, None]
LIT = np.ones((24, 32), np.float32)


def lamp(side: float = 1.2) -> np.ndarray:
    """(3, h, w) log light, strong on the left."""
    return np.broadcast_to(np.linspace(0.3, 0.3 - side, 32, dtype=np.float32), (3, 24, 32)).copy()


def graded(light: np.ndarray, red: float, blue: float) -> np.ndarray:
    """Texture of even skin in a light, with red and blue bent by so much of the light's strength."""
    bend = np.array([red, 0.0, blue], np.float32)[:, None, None] * (light[1] - light[1].mean())
    return np.asarray(SKIN * np.exp(light + bend), np.float32)


def slopes(texture: np.ndarray, light: np.ndarray) -> tuple[float, float]:
    """Change of log red / green and blue / green of the albedo by the light's strength."""
    log_albedo = np.log(texture) - light
    red, blue = (float(np.polyfit(lamp()[1].ravel(), (log_albedo[c] - log_albedo[1]).ravel(), 1)[0]) for c in (0, 2))
    return red, blue


def test_a_plain_photo_stays_bit_for_bit() -> None:
    for red, blue in ((0.0, 0.0), (0.9 * USUAL, -0.9 * USUAL)):
        assert (even_hue(lamp(), graded(lamp(), red, blue), LIT) == lamp()).all()


def test_what_is_beyond_goes_to_the_light() -> None:
    """Golden shade on one half of a face came out olive, its lit half purple."""
    texture = graded(lamp(), -0.5, 0.7)
    found = even_hue(lamp(), texture, LIT)
    assert slopes(texture, lamp()) == pytest.approx((-0.5, 0.7), abs=0.01)
    assert slopes(texture, found) == pytest.approx((-USUAL, USUAL), abs=0.05)
    assert (found[1] == lamp()[1]).all(), "green, which says most of how bright it is, stays"
    assert abs(float((found - lamp()).mean())) < 0.02


def test_a_little_more_grading_changes_little() -> None:
    """A step would make two frames of one film differ."""
    lefts = [even_hue(lamp(), graded(lamp(), 0.0, b), LIT)[2, 0, 0] for b in np.linspace(0.0, 0.6, 25)]
    assert np.abs(np.diff(lefts)).max() < 0.03


def test_lips_and_brows_do_not_bend_the_line() -> None:
    texture = graded(lamp(), 0.0, 0.0)
    texture[:, 10:14, 24:] *= np.array([1.3, 0.4, 0.5], np.float32)[:, None, None]
    assert (even_hue(lamp(), texture, LIT) == lamp()).all()


def test_what_cannot_be_judged_stays() -> None:
    """An even light would divide by nothing, black has no logarithm, and few texels are no face."""
    even = np.zeros((3, 24, 32), np.float32)
    noise = np.random.default_rng(0).uniform(0.1, 0.9, (3, 24, 32)).astype(np.float32)
    assert (even_hue(even, noise, LIT) == even).all()
    few = np.zeros_like(LIT)
    few.ravel()[: FEW - 1] = 1.0
    cases = ((np.zeros_like(noise), LIT), (noise, np.zeros_like(LIT)), (graded(lamp(), 0.9, 0.9), few))
    for texture, lit in cases:
        assert (even_hue(lamp(), texture, lit) == lamp()).all()


def test_a_lost_channel_bends_no_further_than_the_most() -> None:
    light = lamp(3.0)
    found = even_hue(light, np.maximum(graded(light, 0.0, 4.0), 0.004), LIT)
    assert np.isfinite(found).all()
    assert np.abs(found - light).max() <= MOST * np.ptp(light[1]) + 1e-5
