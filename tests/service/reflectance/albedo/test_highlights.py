"""Highlights are taken off the albedo, and nothing else."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from service.arrays import Float32
from service.colour import FULL_CODE, linear_to_srgb, srgb_to_linear
from service.reflectance.albedo.highlights import highlights, skin_detail, without_highlights

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


@pytest.mark.parametrize("name", SKINS)
def test_a_sheen_gets_the_colour_of_most_skin_and_not_of_the_reddest(name: str) -> None:
    """Where a third of the skin around is flushed, as cheeks and chins are, a nose must not become pink."""
    skin, mark = skin_of(name), spot(radius=4.0)[..., None]
    flushed = np.zeros((*skin.shape[:2], 1), np.float32)
    flushed[:, ::24] = 1
    flushed = np.asarray(cv2.GaussianBlur(cv2.dilate(flushed, np.ones((1, 8), np.uint8)), (0, 0), 1))[..., None]
    flushed *= np.hypot(*(np.indices(skin.shape[:2]) - np.array([60, 90]).reshape(2, 1, 1)))[..., None] > 9
    around = np.asarray(skin * (1 + flushed * (np.array([1.0, 0.75, 0.7]) - 1)), np.float32)
    shown = np.asarray(around + 0.5 * mark * skin[..., :1], np.float32)
    made = (shown + highlights(shown, shown, everywhere(skin), SCALE)[0])[MIDDLE].mean((0, 1))
    right = skin[MIDDLE].mean((0, 1))
    assert (made[1:] / made[0] > 0.95 * right[1:] / right[0]).all()


@pytest.mark.parametrize("name", SKINS)
def test_pores_in_a_sheen_leave_no_net_of_dots(name: str) -> None:
    """Taken off as a whole, a sheen left its bright dots and what lay between them too dark and too red."""
    size = (2304, 1536)
    skin = np.asarray(cv2.resize(skin_of(name, (576, 384)), size, interpolation=cv2.INTER_CUBIC), np.float32)
    glossy = np.asarray(cv2.resize(spot((576, 384), 8.0), size), np.float32)
    dots = np.clip(0.5 + 0.3 * np.random.default_rng(2).normal(size=size[::-1]), 0, 1).astype(np.float32)
    dots = np.asarray(cv2.GaussianBlur(dots, (0, 0), 1.5), np.float32)
    shown = np.asarray(skin + 1.2 * skin[..., :1] * (glossy * dots)[..., None], np.float32)
    codes = np.rint(linear_to_srgb(shown) * FULL_CODE).astype(np.uint16)
    mended = without_highlights(codes.copy(), codes, np.full(size[::-1], 255, np.uint8))
    place = (slice(225, 255), slice(345, 375))

    def net(linear: Float32) -> float:
        error = (linear / skin)[place]
        return float(np.asarray(error - cv2.GaussianBlur(error, (0, 0), 4)).std())

    assert net(srgb_to_linear(mended * np.float32(1 / FULL_CODE))) < 0.5 * net(shown)


def test_detail_of_the_skin_stays_and_the_lamp_s_goes() -> None:
    skin = np.tile(np.array(SKINS["light"], np.float32), (4, 1))
    own = np.array([[0.1], [-0.1], [0.0], [0.05]], np.float32) * skin
    lamp = np.array([[0.0], [0.1], [0.1], [-0.05]], np.float32)
    np.testing.assert_allclose(skin_detail(own + lamp, skin, np.ones(4, np.float32)), own, atol=1e-6)
    np.testing.assert_array_equal(skin_detail(own + lamp, skin, np.zeros(4, np.float32)), own + lamp)
    grey = np.full((4, 3), 0.3, np.float32)
    assert not skin_detail(own + lamp, grey, np.ones(4, np.float32)).any(), "nothing is told apart there"
    assert np.isfinite(skin_detail(own, 0 * skin, np.ones(4, np.float32))).all()


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
