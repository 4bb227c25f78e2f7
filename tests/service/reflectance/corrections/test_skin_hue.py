"""Skin does not come out redder or yellower than skin can be; all else stays as it was found."""

from __future__ import annotations

import numpy as np
import pytest

from service.colour import LUMA
from service.reflectance.albedo.light_corrections import BEYOND, FEW, REDDEST, YELLOWEST, within_skin

LIT = np.ones((12, 16), np.float32)
DARK_LIGHT = np.full((3, 12, 16), -1.0, np.float32)


def seen(albedo: tuple[float, float, float]) -> np.ndarray:
    """Texture of one albedo in ``DARK_LIGHT``."""
    return np.full((3, 12, 16), np.array(albedo)[:, None, None] * np.exp(-1.0), np.float32)


def hue_of(linear: np.ndarray, light: np.ndarray) -> tuple[float, float]:
    """Log of red over green and of green over blue of the albedo."""
    red, green, blue = (float(np.median(np.log(linear[i]) - light[i])) for i in range(3))
    return red - green, green - blue


def test_skin_of_every_usual_tone_stays_bit_for_bit() -> None:
    """CIELAB of fair, tan, brown and dark skin as spectrophotometers find it, and a grey photo."""
    for albedo in ((0.53, 0.30, 0.22), (0.41, 0.23, 0.15), (0.32, 0.15, 0.09), (0.15, 0.07, 0.045), (0.3, 0.3, 0.3)):
        assert (within_skin(DARK_LIGHT, seen(albedo), LIT) == DARK_LIGHT).all(), albedo


def test_what_is_beyond_skin_is_the_lights() -> None:
    """Under a red lamp the network left a fair face with 3.3 times as much red as green."""
    linear = seen((0.50, 0.15, 0.06))
    red, yellow = hue_of(linear, within_skin(DARK_LIGHT, linear, LIT))
    assert REDDEST[0] < red < REDDEST[1] - 0.1 and YELLOWEST[0] < yellow < YELLOWEST[1] - 0.1
    lights = (DARK_LIGHT, within_skin(DARK_LIGHT, linear, LIT))
    before, after = (LUMA @ (linear * np.exp(-light))[:, 0, 0] for light in lights)
    assert 0.8 * before < after < before


def test_redder_findings_stay_redder() -> None:
    """And by a little only: a step would make two photos of one face jump."""
    albedos = [(0.2 * np.exp(step), 0.2, 0.15) for step in np.linspace(0.5, 1.6, 23)]
    hues = np.diff([hue_of(seen(a), within_skin(DARK_LIGHT, seen(a), LIT))[0] for a in albedos])
    assert (hues > 0).all() and hues[-1] == pytest.approx(BEYOND * 1.1 / 22, rel=0.6)


def test_dark_skin_may_be_redder_than_fair() -> None:
    dark = seen((0.20, 0.075, 0.04))
    assert (within_skin(DARK_LIGHT, dark, LIT) == DARK_LIGHT).all()
    assert (within_skin(DARK_LIGHT, dark * 4, LIT) != DARK_LIGHT).any()


def test_lips_brows_and_what_is_not_lit_do_not_matter() -> None:
    linear = seen((0.53, 0.30, 0.22))
    linear[:, :4] = np.array([0.5, 0.05, 0.05])[:, None, None]
    assert (within_skin(DARK_LIGHT, linear, LIT) == DARK_LIGHT).all()
    linear[:, :10] = np.array([0.5, 0.05, 0.05])[:, None, None]
    lit = LIT.copy()
    lit[:10] = 0
    lit[10:] = 0.4
    assert (within_skin(DARK_LIGHT, linear, lit) == DARK_LIGHT).all()


def test_black_or_hardly_any_skin_gives_no_logarithm_of_zero() -> None:
    assert np.isfinite(within_skin(DARK_LIGHT, np.zeros((3, 12, 16), np.float32), LIT)).all()
    few = np.zeros_like(LIT)
    few.ravel()[: FEW - 1] = 1
    assert within_skin(DARK_LIGHT, seen((0.9, 0.1, 0.1)), few) is DARK_LIGHT
