"""Roots darken the albedo by their factor, and nothing else."""

import numpy as np

from service.colour import FULL_CODE, linear_to_srgb, srgb_to_linear
from service.reflectance.albedo.beside_skin import darkened


def test_the_factor_is_on_linear_albedo() -> None:
    skin = np.array([0.4, 0.25, 0.2], np.float32)
    albedo = np.tile(np.rint(linear_to_srgb(skin) * FULL_CODE).astype(np.uint16), (64, 96, 1))
    left = np.full((16, 24, 3), 255, np.uint8)
    left[:8] = [128, 64, 255]
    before = albedo.copy()
    found = srgb_to_linear(darkened(albedo, left) / FULL_CODE)
    assert np.allclose(found[:24], skin * np.array([128, 64, 255]) / 255, atol=2e-4)
    assert np.array_equal(albedo[40:], before[40:])


def test_black_stays_black() -> None:
    albedo = np.zeros((8, 8, 3), np.uint16)
    assert not darkened(albedo, np.zeros((2, 2, 3), np.uint8)).any()
