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


def test_black_and_flat_patches_are_described() -> None:
    black = np.zeros((256, 256))
    numbers = m.describe(m.Patch("black", np.zeros((256, 256, 3)), np.zeros((2, 256, 256)), 14.0, black))
    assert all(np.isfinite(v) for v in numbers.values())
    assert numbers["tilt deg"] == 0.0
