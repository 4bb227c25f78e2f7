"""Heights out of normals: the measure of displacement against the relief of a head."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")

from benchmarks.detail.measure import BANDS_MM, heights

PER_MM, SIDE = 6.0, 360
INSIDE = (slice(90, -90), slice(90, -90))
"""Away from the border, where slopes around are those of one side."""


def slopes(depth_mm: float, period_mm: float, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Heights towards the camera of waves, and their normals along right, down and forward."""
    down, across = np.mgrid[:SIDE, :SIDE] / PER_MM
    phase = 2 * np.pi / period_mm * (np.cos(angle) * across + np.sin(angle) * down)
    slope = -depth_mm * 2 * np.pi / period_mm * np.sin(phase)
    normal = np.stack([-np.cos(angle) * slope, -np.sin(angle) * slope, -np.ones_like(slope)], -1)
    return depth_mm * np.cos(phase), normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def test_waves_have_their_height() -> None:
    for period, limits in ((4.0, BANDS_MM[2]), (2.0, BANDS_MM[1]), (1.0, BANDS_MM[0])):
        for angle in (0.0, np.pi / 2):
            true, normal = slopes(0.05, period, angle)
            found = heights(normal, np.ones((SIDE, SIDE), bool), PER_MM, limits)
            np.testing.assert_allclose(found[INSIDE], true[INSIDE], atol=0.1 * 0.05)  # of 4 mm 6 % count as shape


def test_another_band_has_none_and_a_slanted_surface_is_no_height() -> None:
    _, normal = slopes(0.05, 4.0, 0.0)
    whole = np.ones((SIDE, SIDE), bool)
    assert np.abs(heights(normal, whole, PER_MM, BANDS_MM[0])[INSIDE]).max() < 1e-3
    flat = np.broadcast_to(np.array([0.6, 0.0, -0.8]), (SIDE, SIDE, 3))
    assert np.abs(heights(flat, whole, PER_MM, BANDS_MM[2])).max() < 1e-6


def test_normals_that_look_away_give_finite_heights() -> None:
    away = np.zeros((SIDE, SIDE, 3))
    away[..., 2] = 1.0
    away[10:20, 10:20] = 0.0
    assert np.isfinite(heights(away, np.ones((SIDE, SIDE), bool), PER_MM, BANDS_MM[1])).all()
