"""Highlights are taken off the albedo, and nothing else."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from service.arrays import Float32
from service.colour import FULL_CODE, linear_to_srgb, srgb_to_linear
from service.reflectance.albedo.highlights import highlights, without_highlights

SKINS = {"dark": [0.16, 0.08, 0.05], "brown": [0.34, 0.19, 0.12], "light": [0.56, 0.37, 0.27]}
SCALE = 192 / 576
MIDDLE = (slice(58, 63), slice(88, 93))


def skin_of(name: str, size: tuple[int, int] = (192, 128)) -> Float32:
    """(h, w, 3) linear albedo that varies by some percent, as skin does."""
    noise = np.random.default_rng(0).normal(0, 0.03, (*size[::-1], 1)).astype(np.float32)
    slow = cv2.GaussianBlur(np.random.default_rng(1).normal(0, 2, (*size[::-1], 3)).astype(np.float32), (0, 0), 12)
    return np.asarray(np.array(SKINS[name]) * np.exp(noise + slow), np.float32)


def spot(size: tuple[int, int] = (192, 128), radius: float = 1.5) -> Float32:
    y, x = np.indices(size[::-1])
    return np.asarray(np.exp(-((x - 90) ** 2 + (y - 60) ** 2) / (2 * radius**2)), np.float32)


def everywhere(skin: Float32) -> Float32:
    return np.ones(skin.shape[:2], np.float32)


@pytest.mark.parametrize("name", SKINS)
def test_a_glint_goes_and_the_skin_stays(name: str) -> None:
    """As white dots on nose and brow they would shine in every other light too."""
    skin = skin_of(name)
    shown = skin + 0.8 * skin[..., :1] * spot()[..., None]
    found = highlights(shown, shown, everywhere(skin), SCALE)[0]
    away = np.hypot(*(np.indices(skin.shape[:2]) - np.array([60, 90]).reshape(2, 1, 1))) > 12
    assert np.abs(found[away]).max() < 0.02 * skin.mean()
    assert np.abs(shown + found - skin)[MIDDLE].mean() < 0.55 * np.abs(shown - skin)[MIDDLE].mean()


@pytest.mark.parametrize("name", SKINS)
def test_a_highlight_that_left_only_grey_is_coloured_again(name: str) -> None:
    """White in the photo, divided by strong light: as dark as the skin around it or darker, and grey."""
    skin, mark = skin_of(name), spot(radius=4.0)[..., None]
    grey = skin + mark * (0.8 * skin.mean(2, keepdims=True) - skin)
    photo = 0.2 * skin + 0.8 * mark
    found = highlights(grey, photo, everywhere(skin), SCALE)[0]
    assert np.abs(grey + found - skin)[MIDDLE].mean() < 0.55 * np.abs(grey - skin)[MIDDLE].mean()
    unseen = highlights(grey, 0.2 * skin, everywhere(skin), SCALE)[0]
    assert np.abs(unseen).max() < 0.2 * np.abs(found).max(), "stubble is grey too, but did not shine"


@pytest.mark.parametrize("name", SKINS)
def test_moles_lips_and_paler_patches_are_no_highlights(name: str) -> None:
    """Pigment changes brightness and colour together, in other ways than grey light does."""
    skin, mark = skin_of(name), spot(radius=6.0)[..., None]
    for factor in ([0.4, 0.3, 0.25], [1.0, 0.6, 0.65], [1.25, 1.25, 1.25], [1.2, 1.3, 1.1]):
        marked = np.asarray(skin * (1 + mark * (np.array(factor) - 1)), np.float32)
        found = highlights(marked, marked, everywhere(skin), SCALE)[0]
        assert np.abs(found).max() < 0.05 * skin[..., 0].max()


def test_only_skin_is_judged() -> None:
    """White hair and the whites of the eyes are pale by right."""
    shown = skin_of("brown") + 0.3 * spot()[..., None]
    assert not highlights(shown, shown, np.zeros(shown.shape[:2], np.float32))[0].any()
    codes, skin = np.rint(linear_to_srgb(shown) * FULL_CODE).astype(np.uint16), np.full((128, 192), 255, np.uint8)
    mended = without_highlights(codes.copy(), codes, skin)
    nowhere = without_highlights(codes.copy(), codes, skin, np.zeros((20, 30), np.float32))
    assert np.array_equal(without_highlights(codes.copy(), codes, 0 * skin), nowhere)
    assert (mended != nowhere).any() and mended[60, 90].sum() < nowhere[60, 90].sum()
    assert np.allclose(srgb_to_linear(nowhere / FULL_CODE), shown.clip(0, 1), atol=1e-3)


@pytest.mark.parametrize("value", [0, 1, 30000, 65535])
@pytest.mark.parametrize("size", [(1, 1), (7, 5), (600, 400)])
def test_flat_and_tiny_maps_stay(value: int, size: tuple[int, int]) -> None:
    """Black has no ratios, grey no colour; nothing is divided by nothing."""
    flat = np.full((*size[::-1], 3), value, np.uint16)
    assert np.array_equal(without_highlights(flat.copy(), flat, np.full(size[::-1], 255, np.uint8)), flat)
