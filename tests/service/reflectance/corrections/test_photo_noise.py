"""Noise of small photos is no relief; creases and large photos stay."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from service.colour import FULL_CODE
from service.reflectance.corrections.photo_noise import COARSE_MM, FINE_MM, excess, without_noise
from service.reflectance.planes import Planes
from service.reflectance.subject import COVERED, GEOMETRY_SIZE, LIT

Float = npt.NDArray[np.float32]

WIDTH, HEIGHT = GEOMETRY_SIZE
CREASE = slice(250, 254)
"""Rows of a fold: 2 mm."""


def skin(noise: float, crease: float, seed: int = 0) -> Float:
    """Grey skin in soft light, with noise a texel wide and one fold across the middle."""
    column = np.linspace(0, 3, WIDTH, dtype=np.float32)
    grey = np.tile(0.5 + 0.1 * np.sin(column), (HEIGHT, 1)).astype(np.float32)
    grey *= 1 + noise * np.random.default_rng(seed).standard_normal(grey.shape).astype(np.float32)
    grey[CREASE, 200:500] *= 1 - crease
    return grey


def planes_of(lit: float = 1.0) -> Planes:
    planes = Planes(GEOMETRY_SIZE)
    planes.add_coarse([LIT, COVERED], np.stack([np.full((64, 96), lit, np.float32), np.zeros((64, 96), np.float32)]))
    return planes


def codes(grey: Float) -> npt.NDArray[np.uint16]:
    return np.rint(grey * FULL_CODE).astype(np.uint16)


def test_noise_goes_and_a_crease_stays() -> None:
    """Blocks of a JPEG file, read as creases, were worms all over the cheeks."""
    noisy, plain = skin(0.04, 0.3), skin(0.0, 0.3)
    clean = noisy - excess(noisy, np.ones_like(noisy))
    away = (slice(300, 450), slice(100, 600))
    assert (clean - plain)[away].std() < 0.25 * (noisy - plain)[away].std()
    inside = (CREASE, slice(250, 450))
    beside = (slice(200, 220), slice(250, 450))
    depth = 1 - clean[inside].mean() / clean[beside].mean()
    assert depth > 0.8 * 0.3
    none = skin(0.0, 0.3)
    assert np.abs(excess(none, np.ones_like(none)))[inside].max() < 0.01, "no noise, nothing to take off"


def test_only_small_photos_change_and_the_more_the_smaller() -> None:
    before = codes(skin(0.04, 0.3))
    for known in (None, 0.0, FINE_MM):
        assert np.array_equal(without_noise(before.copy(), planes_of(), known), before)
    change = [
        float(np.abs(without_noise(before.copy(), planes_of(), size).astype(np.float64) - before).mean())
        for size in (0.5 * (FINE_MM + COARSE_MM), COARSE_MM, 9.0)
    ]
    assert 0 < change[0] < 0.6 * change[1] and change[1] == change[2]


@pytest.mark.parametrize("case", ["nan", "black", "white", "no skin", "no planes"])
def test_whatever_comes_in_what_comes_out_is_a_number(case: str) -> None:
    """The usual detail of nothing is NaN, and black skin would be divided by."""
    grey, lit = skin(0.04, 0.3), 1.0
    if case == "nan":
        grey[100:140] = np.nan
    elif case in ("black", "white"):
        grey[:] = float(case == "white")
    elif case == "no skin":
        lit = 0.0
    with np.errstate(all="raise", under="ignore"):
        found = excess(grey, np.full_like(grey, lit))
    assert np.isfinite(found).all() and np.abs(found).max() <= 1
    if case == "no skin":
        assert not found.any()
    if case == "no planes":
        before = codes(grey)
        assert np.array_equal(without_noise(before.copy(), Planes(GEOMETRY_SIZE), 1.0), before)
