"""The list of corrections: each has a switch that works and a count that is true.

Corrections of the light on the chart: hue, contrast, and light where no skin is seen.
"""

from __future__ import annotations

import numpy as np
import pytest

from service.errors import UsageError
from service.options import Options
from service.reflectance.albedo.corrections import (
    FEW,
    ChartLight,
    as_seen_skin,
    continued,
    evenness,
    less_contrast,
    no_bluer,
    no_whiter_cloth,
    within_skin,
)
from service.reflectance.albedo.diffuse_albedo import NAMES


def test_unknown_and_doubled_names_are_refused_with_those_that_there_are() -> None:
    with pytest.raises(UsageError, match=r"'magic'.*highlights"):
        Options(without=("magic",))
    with pytest.raises(UsageError, match="twice"):
        Options(without=(NAMES[0], NAMES[0]))
    assert Options(without=NAMES).to_json()["without"] == list(NAMES)


SHAPE = (192, 288)
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
EVERYWHERE = np.ones(SHAPE, np.float32)


def test_no_lit_skin_leaves_the_light_as_it_is_and_all_is_finite() -> None:
    light = np.random.default_rng(1).normal(size=(3, *SHAPE)).astype(np.float32)
    assert np.array_equal(less_contrast(light, np.zeros(SHAPE, np.float32)), light)
    assert np.isfinite(less_contrast(light, 1e-6 * EVERYWHERE)).all()
    assert np.allclose(less_contrast(light, EVERYWHERE, kept=1.0), light, atol=1e-5)


def test_light_is_believed_where_it_is_even() -> None:
    """Its shade stayed in the albedo: dark eye sockets and pale rims of the face in the light of one lamp."""
    light = np.where(X < 144, -1.5, 0.0)[None] * np.ones((3, 1, 1))
    told = evenness(light.astype(np.float32), EVERYWHERE)
    assert told[:, 138:150].max() < 0.3
    assert told[:, :72].min() > 0.95
    assert np.isfinite(evenness(light.astype(np.float32), 0 * EVERYWHERE)).all()


LIT = np.ones((12, 16), np.float32)
DARK_LIGHT = np.full((3, 12, 16), -1.0, np.float32)


def seen(albedo: tuple[float, float, float]) -> np.ndarray:
    """Texture of one albedo in ``DARK_LIGHT``."""
    return np.full((3, 12, 16), np.array(albedo)[:, None, None] * np.exp(-1.0), np.float32)


def test_skin_of_every_usual_tone_stays_bit_for_bit() -> None:
    """CIELAB of fair, tan, brown and dark skin as spectrophotometers find it, and a grey photo."""
    for albedo in ((0.53, 0.30, 0.22), (0.41, 0.23, 0.15), (0.32, 0.15, 0.09), (0.15, 0.07, 0.045), (0.3, 0.3, 0.3)):
        assert (within_skin(DARK_LIGHT, seen(albedo), LIT) == DARK_LIGHT).all(), albedo


def test_black_or_hardly_any_skin_gives_no_logarithm_of_zero() -> None:
    assert np.isfinite(within_skin(DARK_LIGHT, np.zeros((3, 12, 16), np.float32), LIT)).all()
    few = np.zeros_like(LIT)
    few.ravel()[: FEW - 1] = 1
    assert within_skin(DARK_LIGHT, seen((0.9, 0.1, 0.1)), few) is DARK_LIGHT


CONTEXT_SHAPE = (96, 144)
ALBEDO = np.array([0.5, 0.3, 0.2], np.float32)[:, None, None]


def test_even_light_stays_even_whatever_was_found_in_made_up_parts() -> None:
    """Colour that was continued carries its source's light; the network's guess there would print a halo."""
    light = np.full((3, 48, 72), 0.4, np.float32)
    seen = np.zeros((48, 72), np.float32)
    seen[10:30, 20:50] = 1
    light[:, seen == 0] = -2.0
    assert np.abs(continued(light, seen) - 0.4).max() < 1e-4


def test_nothing_seen_and_all_seen_change_nothing() -> None:
    """A weight of zero would be divided by."""
    light = np.random.default_rng(1).normal(size=(3, 20, 30)).astype(np.float32)
    assert np.array_equal(continued(light, np.zeros((20, 30), np.float32)), light)
    assert np.allclose(continued(light, np.ones((20, 30), np.float32)), light, atol=1e-5)


def _half_seen(shade: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Texture, light as a network may find it, and lit skin: the left half of a face, made up on in shade."""
    lit = np.zeros(CONTEXT_SHAPE, np.float32)
    lit[:, :72] = 1
    light = np.where(lit > 0, np.float32(-0.3), np.float32(1.5)) * np.ones((3, 1, 1), np.float32)
    texture = ALBEDO * np.exp(np.where(lit > 0, np.float32(-0.3), np.float32(shade)))
    return np.asarray(texture, np.float32), light, lit


def test_made_up_skin_is_as_fair_as_the_seen_whatever_shade_was_continued() -> None:
    """Else necks come out paler than faces, or with the shadow of the jaw, by as much as the fill is off."""
    for shade in (-1.5, 0.4):
        texture, light, lit = _half_seen(shade)
        goes_on = continued(light, lit)
        made = as_seen_skin(goes_on, texture, light, lit, 1 - lit, lit)
        away = np.abs(np.log(texture[:, :, 84:] / ALBEDO) - made[:, :, 84:])
        unmended = np.abs(np.log(texture[:, :, 84:] / ALBEDO) - goes_on[:, :, 84:])
        assert away.max() < 0.02 < 0.5 < unmended.min()
        assert np.array_equal(made[:, :, :60], goes_on[:, :, :60]), "seen skin keeps its light"


def test_no_lit_skin_or_nothing_made_up_changes_no_light() -> None:
    """The mean of no skin would be 0 / 0, and black texels have no logarithm."""
    texture, light, lit = _half_seen(-1.5)
    assert as_seen_skin(light, texture, light, 0 * lit, 1 - lit, 0 * lit) is light
    assert as_seen_skin(light, texture, light, lit, 0 * lit, lit) is light
    assert np.isfinite(as_seen_skin(light, 0 * texture, light, lit, 1 - lit, lit)).all()


def test_no_shirt_is_whiter_than_white() -> None:
    """Dark skin was fair in light in which the shirt beside it would mirror more than falls on it."""
    lit = np.ones((12, 16), np.float32)
    bright = no_whiter_cloth(DARK_LIGHT, lit, cloth=0.81)
    assert np.allclose(np.exp(bright), 0.9), "as bright as a shirt of 0.81 needs"
    for cloth, where in ((0.0, lit), (0.3, lit), (1.0, 0 * lit)):
        told = no_whiter_cloth(DARK_LIGHT, where, cloth)
        assert np.array_equal(told, DARK_LIGHT), "no cloth, grey cloth, or no skin tell nothing"
    assert np.isfinite(no_whiter_cloth(0 * DARK_LIGHT - 50, lit, 1.0)).all(), "in no light the share would be 1 / 0"


def test_white_beards_are_white_in_whatever_light_the_skin_tells() -> None:
    """A white beard was blue, as the skin's hue told a warmer light than there was. Skin keeps the light it told."""
    white = seen((0.6, 0.6, 0.55))
    warm = np.tile(np.array([-0.6, -1.0, -1.6], np.float32)[:, None, None], (1, 12, 16))
    beard = np.where(np.arange(12)[:, None] >= 6, 1, 0) * np.ones((12, 16), np.float32)
    state = ChartLight(warm, warm, white, 1 - beard, LIT, 0 * LIT, LIT)
    after = no_bluer(state)
    assert np.array_equal(after[:, :6], warm[:, :6])
    red, green, blue = np.exp(np.log(white) - after)[:, 6:]
    assert np.allclose(green, red, rtol=1e-4) and np.allclose(blue, red, rtol=1e-4)
    assert np.allclose(after[0], warm[0]), "only what is bluer than red changes"
    brown = ChartLight(DARK_LIGHT, DARK_LIGHT, seen((0.2, 0.1, 0.05)), 1 - beard, LIT, 0 * LIT, LIT)
    assert np.array_equal(no_bluer(brown), DARK_LIGHT)
    # Brows of few photons were teal in warm light; eye shadow, which is paler, may be blue. Both are told as lit skin.
    for colour, stays in ((0.01, False), (0.2, True)):
        painted = ChartLight(DARK_LIGHT, DARK_LIGHT, seen((colour, colour, 1.6 * colour)), LIT, LIT, 0 * LIT, LIT)
        assert np.allclose(no_bluer(painted), DARK_LIGHT) == stays
    assert np.isfinite(no_bluer(ChartLight(warm, warm, 0 * white, 0 * LIT, LIT, LIT, LIT))).all()
