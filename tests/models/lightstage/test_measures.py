"""The measures themselves, on surfaces whose numbers are known."""

import numpy as np
import pytest

pytest.importorskip("torch")

from models.lightstage import measures as m

pytestmark = pytest.mark.train


def _wave(wavelength_mm: float, ppm: float = 10.0, size: int = 400) -> np.ndarray:
    x = np.arange(size) / ppm
    return np.sin(2 * np.pi * x / wavelength_mm)[None].repeat(size, 0)


def test_band_rms_finds_a_wave_in_its_band_only() -> None:
    assert m.band_rms(_wave(2.0), 10.0, 1.0, 4.0) == pytest.approx(np.sqrt(0.5), rel=0.02)
    assert m.band_rms(_wave(2.0), 10.0, 0.3, 1.0) < 0.01
    assert np.isnan(m.band_rms(_wave(2.0), 2.0, 0.12, 0.3))  # texels too large to say anything


def test_height_comes_back_from_its_slopes() -> None:
    rng = np.random.default_rng(0)
    spectrum = np.fft.fft2(rng.normal(size=(256, 256)))
    f = np.hypot(np.fft.fftfreq(256)[:, None], np.fft.fftfreq(256)[None])
    height = np.fft.ifft2(spectrum * ((f > 0.02) & (f < 0.08))).real
    slope = np.stack([np.gradient(height, axis=1), -np.gradient(height, axis=0)]) * 10.0
    again = m.height_of(slope, 10.0)
    inner = (slice(90, 166), slice(90, 166))
    assert m.correlation(again[inner], height[inner]) > 0.95  # would break: a sign, or y down


def test_correlation_of_nothing_is_zero() -> None:
    assert m.correlation(np.ones((4, 4)), np.random.default_rng(0).normal(size=(4, 4))) == 0.0


def test_black_and_flat_patches_are_described() -> None:
    black = np.zeros((256, 256))
    numbers = m.describe(m.Patch("black", np.zeros((256, 256, 3)), np.zeros((2, 256, 256)), 14.0, black))
    assert all(np.isfinite(v) for v in numbers.values())
    assert numbers["tilt deg"] == 0.0


def test_the_detail_of_gloss_is_relative_to_its_level() -> None:
    """Half as glossy a person has the same detail, and a wave is found in its own band."""
    bright = 0.6 * np.exp(0.1 * _wave(1.2))
    one, half = (m.gloss_bands(level * bright, 10.0) for level in (1.0, 0.5))
    assert one == pytest.approx(half)
    assert one["gloss 0.8-1.6"] == pytest.approx(10.0 * np.sqrt(0.5), rel=0.02)
    assert max(one["gloss 0.4-0.8"], one["gloss 1.6-3"]) < 0.5
