"""Light goes on into parts of the texture that no photo showed."""

from __future__ import annotations

import numpy as np

from service.reflectance.diffuse_albedo import continued


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
