"""Skin that comes out brighter than skin of one person is."""

from __future__ import annotations

import numpy as np

from service.reflectance.corrections.albedo_ceiling import ABOVE, below_ceiling

SHAPE = (60, 90)
EVERYWHERE = np.ones(SHAPE, np.float32)
NOWHERE = np.zeros(SHAPE, np.float32)
ALBEDO = np.array([0.5, 0.3, 0.2], np.float32)[:, None, None] * np.ones((1, *SHAPE), np.float32)


def _log_albedo(texture: np.ndarray, light: np.ndarray) -> np.ndarray:
    return np.asarray(np.log(texture / ALBEDO) - light)


def test_a_hollow_that_is_only_in_the_head_does_not_glow() -> None:
    """The photo shows an ear in plain light, the head has a fold there; the ear came out e times too bright."""
    light = np.zeros((3, *SHAPE), np.float32)
    light[:, 20:30, 5:13] = -1
    result = _log_albedo(ALBEDO, below_ceiling(light, ALBEDO, EVERYWHERE, NOWHERE))
    assert result[:, 23:27, 7:11].max() < ABOVE + 0.15
    assert np.abs(result[:, :, 30:]).max() < 1e-5


def test_light_that_explains_the_photo_stays_bit_for_bit() -> None:
    """However dark the shade and whatever the tone, and with brows and spots of a texel in it."""
    rng = np.random.default_rng(0)
    light = np.repeat(np.linspace(-2, 0.5, 90, dtype=np.float32)[None], 60, 0)[None] * np.ones((3, 1, 1), np.float32)
    spots = np.where(rng.uniform(size=SHAPE) < 0.02, np.float32(0.3), np.float32(1))
    for tone in (0.1, 1.0):
        texture = np.asarray(ALBEDO * tone * np.exp(light) * spots, np.float32)
        assert np.array_equal(below_ceiling(light, texture, EVERYWHERE, NOWHERE), light)


def test_black_and_unlit_photos_tell_nothing() -> None:
    """Logarithm of nothing, quantile of nothing, and a blur that is divided by nothing."""
    light = np.zeros((3, *SHAPE), np.float32)
    few = np.zeros(SHAPE, np.float32)
    few[5, 5:9] = 1
    for texture, lit in ((np.zeros_like(ALBEDO), EVERYWHERE), (ALBEDO, NOWHERE), (ALBEDO, few)):
        assert np.array_equal(below_ceiling(light, texture, lit, NOWHERE), light)
    half = np.where(np.arange(90) < 45, np.float32(1), np.float32(0)) * EVERYWHERE
    assert np.isfinite(below_ceiling(light, 50 * ALBEDO * half, half, NOWHERE)).all()


def test_lids_are_no_fairer_than_the_face() -> None:
    """Deep between brow and cheek they get less light than the photo shows by as much as the fit is off."""
    face = np.linspace(-0.2, 0.2, 90, dtype=np.float32)[None] * np.ones((60, 1), np.float32)
    texture, lids = np.asarray(ALBEDO * np.exp(face), np.float32), NOWHERE.copy()
    lids[20:40, 60:80] = 1
    light = np.asarray(-0.3 * lids * np.ones((3, 1, 1)), np.float32)
    result = _log_albedo(texture, below_ceiling(light, texture, EVERYWHERE, lids))
    assert result[:, 25:35, 65:75].max() < 0.15 < _log_albedo(texture, light)[:, 25:35, 65:75].min()
    assert np.allclose(result[:, :, :50], face[:, :50], atol=1e-4)
