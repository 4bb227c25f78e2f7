"""Light goes on into parts of the texture that no photo showed."""

from __future__ import annotations

import numpy as np

from service.colour import linear_to_srgb, srgb_to_linear
from service.fit.eye_white import ALBEDO
from service.reflectance.diffuse_albedo import BRIGHTEST, continued, light_between_lids, seamless, without


def test_even_light_stays_even_whatever_was_found_in_made_up_parts() -> None:
    """Colour that was continued carries its source's light; the network's guess there would print a halo."""
    light = np.full((3, 48, 72), 0.4, np.float32)
    seen = np.zeros((48, 72), np.float32)
    seen[10:30, 20:50] = 1
    light[:, seen == 0] = -2.0
    assert np.abs(continued(light, seen) - 0.4).max() < 1e-4


def test_seen_parts_keep_their_light_and_joins_are_smooth() -> None:
    rng = np.random.default_rng(0)
    light = rng.normal(size=(3, 48, 72)).astype(np.float32)
    seen = np.zeros((48, 72), np.float32)
    seen[:, 30:] = 1
    result = continued(light, seen)
    assert np.abs(result[:, :, 40:] - light[:, :, 40:]).max() < 1e-4
    assert np.abs(np.diff(result[:, :, :25], axis=2)).max() < 0.3
    assert np.isfinite(result).all()


def test_nothing_seen_and_all_seen_change_nothing() -> None:
    """A weight of zero would be divided by."""
    light = np.random.default_rng(1).normal(size=(3, 20, 30)).astype(np.float32)
    assert np.array_equal(continued(light, np.zeros((20, 30), np.float32)), light)
    assert np.allclose(continued(light, np.ones((20, 30), np.float32)), light, atol=1e-5)


def test_the_white_of_an_eye_is_white_in_any_light() -> None:
    """In dim or coloured light eyes would else be darker than the skin, or of the light's opposite colour."""
    for factor in ([0.05, 0.05, 0.05], [0.9, 0.4, 0.2], [1.0, 1.0, 1.0]):
        coded = linear_to_srgb((ALBEDO * factor).astype(np.float32)).reshape(1, 1, 3) * 2 - 1
        bare = without(np.log(np.array(factor, np.float32)), coded)
        assert np.allclose(srgb_to_linear(bare * 0.5 + 0.5)[0, 0], ALBEDO, atol=2e-3)


def test_eyes_that_were_not_seen_lose_the_light_of_the_face() -> None:
    """Less what the lids shade; finite without any lit skin, and no tooth is brighter than a tooth can be."""
    light = np.full((3, 8, 12), -1.0, np.float32)
    light[:, :, :6] = 5.0
    lit = np.zeros((8, 12), np.float32)
    lit[:, 6:] = 1
    found = light_between_lids(light, lit)
    assert (found < -1.0).all() and (found > -2.0).all()
    assert np.isfinite(light_between_lids(light, 0 * lit)).all()
    bright = without(np.full(3, -50.0, np.float32), np.ones((2, 2, 3), np.float32))
    assert np.allclose(srgb_to_linear(bright * 0.5 + 0.5), BRIGHTEST, atol=2e-3)


def test_light_meets_itself_at_the_seam() -> None:
    """Left and right border, and both halves of the upper one, are the same places; the face stays as it is."""
    light = np.random.default_rng(0).normal(size=(3, 96, 144)).astype(np.float32).cumsum(2) * np.float32(0.1)
    made = seamless(light)
    for edge in (made[:, :, :1] - made[:, :, -1:], made[:, :1] - made[:, :1, ::-1]):
        assert np.abs(edge).max() < 0.02 * np.abs(light[:, :, :1] - light[:, :, -1:]).max()
    assert np.array_equal(made[:, 14:, 22:-22], light[:, 14:, 22:-22])
    assert np.array_equal(seamless(light[:, :1, :1]), light[:, :1, :1])
