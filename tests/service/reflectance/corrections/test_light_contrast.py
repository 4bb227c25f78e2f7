"""Half of the light's local contrast goes to the skin; its wide form stays."""

from __future__ import annotations

import numpy as np

from service.reflectance.albedo.light_corrections import KEPT, less_contrast

SHAPE = (192, 288)
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
EVERYWHERE = np.ones(SHAPE, np.float32)


def test_a_small_dark_region_keeps_a_share_of_its_shade() -> None:
    spot = -0.4 * np.exp(-((X - 144) ** 2 + (Y - 96) ** 2) / (2 * 4.0**2))
    found = less_contrast(np.stack([spot] * 3).astype(np.float32), EVERYWHERE)
    assert abs(found[0, 96, 144] / -0.4 - KEPT) < 0.12
    assert np.abs(found[:, :, :30]).max() < 1e-3, "far from it nothing changes"


def test_the_wide_form_of_the_light_stays() -> None:
    wide = np.stack([0.8 * np.sin(2 * np.pi * X / 288)] * 3).astype(np.float32)
    found = less_contrast(wide, EVERYWHERE)
    assert np.abs(found - wide)[:, 50:-50, 50:-50].max() < 0.05


def test_what_is_not_lit_has_no_say() -> None:
    lit = EVERYWHERE.copy()
    lit[:, 150:] = 0
    light = np.zeros((3, *SHAPE), np.float32)
    light[:, :, 150:] = -5
    found = less_contrast(light, lit)
    assert np.abs(found[:, :, :150]).max() < 1e-4
    assert np.array_equal(found[:, :, -30:], light[:, :, -30:]), "far from all lit skin it stays"


def test_no_lit_skin_leaves_the_light_as_it_is_and_all_is_finite() -> None:
    light = np.random.default_rng(1).normal(size=(3, *SHAPE)).astype(np.float32)
    assert np.array_equal(less_contrast(light, np.zeros(SHAPE, np.float32)), light)
    assert np.isfinite(less_contrast(light, 1e-6 * EVERYWHERE)).all()
    assert np.allclose(less_contrast(light, EVERYWHERE, kept=1.0), light, atol=1e-5)
