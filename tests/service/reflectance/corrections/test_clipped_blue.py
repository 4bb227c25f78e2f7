"""Skin in warm light that has no blue left."""

from __future__ import annotations

import numpy as np
import pytest

from service.colour import linear_to_srgb, srgb_to_linear
from service.reflectance.corrections.clipped_blue import LEAST_TEXELS, lacks_blue, missing, usual_blue, with_blue

SKIN = np.array([0.45, 0.28, 0.2], np.float32)


def codes(*values: float) -> np.ndarray:
    return np.array(values, np.float32) / 255


def test_only_lit_skin_without_blue_is_missing_it() -> None:
    """Black hair, a blue cap, pale skin and skin in bluish light stay as they are."""
    assert missing(codes(140, 55, 2)) == 1
    assert 0 < missing(codes(140, 55, 8)) < 1
    for kept in ((140, 55, 20), (12, 8, 1), (2, 10, 200), (2, 140, 1), (230, 200, 180), (0, 0, 0)):
        assert missing(codes(*kept)) == 0, kept


def test_blue_comes_back_as_the_rest_of_the_skin_has_it() -> None:
    """Half of a face under a light that leaves its blue, half under one that does not."""
    light = np.repeat(np.array([[0.9, 0.7, 0.5], [0.5, 0.2, 0.001]], np.float32), 60, 0)
    texture = np.rint(linear_to_srgb(SKIN * light) * 255).astype(np.float32) * np.float32(1 / 255)
    albedo = srgb_to_linear(texture) / light
    blue = usual_blue(albedo, texture, np.ones(120, np.float32))
    assert blue is not None and blue == pytest.approx(0.2 / np.sqrt(0.45 * 0.28), rel=0.03)
    mended = srgb_to_linear(with_blue(linear_to_srgb(albedo), missing(texture), blue))
    assert np.allclose(mended[60:, 2], 0.2, rtol=0.06)
    assert np.allclose(mended[:60], albedo[:60], atol=1e-3)


def test_too_little_skin_tells_no_blue() -> None:
    """A median of nothing, and a division by an albedo of nothing."""
    few = np.tile(SKIN, (LEAST_TEXELS - 1, 1))
    assert usual_blue(few, few, np.ones(len(few), np.float32)) is None
    many = np.zeros((200, 3), np.float32)
    assert usual_blue(many, many + 0.5, np.ones(200, np.float32)) is None
    assert usual_blue(many + 0.5, many + 0.5, np.zeros(200, np.float32)) is None
    assert np.isfinite(with_blue(many, np.ones(200, np.float32), 0.6)).all()


def test_a_texture_says_when_it_lacks_blue() -> None:
    texture = np.full((20, 30, 3), (150, 60, 1), np.uint8)
    assert lacks_blue(texture, None)
    assert not lacks_blue(texture, np.zeros((8, 12), np.float32))
    assert not lacks_blue(np.full((20, 30, 3), (180, 140, 120), np.uint8), None)
