"""Numbers that describe a piece of skin, real or synthetic: energy by wavelength, slopes, colour against height."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from models.lightstage.skin.chromophores import lab, typology_angle

Array = npt.NDArray[np.float64]

BANDS_MM = ((0.12, 0.3), (0.3, 1.0), (1.0, 4.0))
GLOSS_BANDS_MM = ((0.4, 0.8), (0.8, 1.6), (1.6, 3.0), (3.0, 6.0))


@dataclass(frozen=True)
class Patch:
    """A piece of skin.

    Attributes:
        name: for the table.
        albedo: (h, w, 3) float64 linear sRGB.
        slope: (2, h, w) float64 surface slopes along image x and up; None where there are no normals.
        texels_per_mm: resolution.
        gloss: (h, w) float64 specular albedo in [0, 1]; None where there is none.
    """

    name: str
    albedo: Array
    slope: Array | None
    texels_per_mm: float
    gloss: Array | None = None


def slopes(normal: npt.NDArray[np.floating]) -> Array:
    """(2, h, w) of (h, w, 3) tangent normals, +Y up; normals flatter than 10 degrees to the surface are cut."""
    z = np.maximum(normal[..., 2], 0.17)
    return np.stack([-normal[..., 0] / z, -normal[..., 1] / z]).astype(np.float64)


def band(field: Array, texels_per_mm: float, low_mm: float, high_mm: float) -> Array:
    """(h, w) part of a field with wavelengths in [low, high) mm; edges are tapered by a Hann window before."""
    h, w = field.shape
    window = np.outer(np.hanning(h + 2)[1:-1], np.hanning(w + 2)[1:-1])
    mean = float((field * window).sum() / window.sum())
    frequency = np.hypot(np.fft.fftfreq(h)[:, None], np.fft.fftfreq(w)[None]) * texels_per_mm
    inside = (frequency > 1.0 / high_mm) & (frequency <= 1.0 / low_mm)
    return np.asarray(np.fft.ifft2(np.fft.fft2((field - mean) * window) * inside).real)


def band_rms(field: Array, texels_per_mm: float, low_mm: float, high_mm: float) -> float:
    """Root mean square of a band, corrected for the window; nan where the texels do not resolve half of the band."""
    if 2.0 / texels_per_mm > 0.5 * (low_mm + high_mm):
        return float("nan")
    h, w = field.shape
    window = np.outer(np.hanning(h + 2)[1:-1], np.hanning(w + 2)[1:-1])
    return float(np.sqrt((band(field, texels_per_mm, low_mm, high_mm) ** 2).sum() / (window**2).sum()))


def log_luminance(albedo: Array) -> Array:
    """(h, w) natural logarithm of the luminance of linear sRGB, floored at 0.002."""
    return np.asarray(np.log(np.maximum(albedo @ np.array([0.2126, 0.7152, 0.0722]), 0.002)))


def gloss_bands(gloss: Array, texels_per_mm: float) -> dict[str, float]:
    """100 x rms of the logarithm of specular albedo (h, w) in [0, 1], floored at 0.02, by wavelength."""
    logs = np.log(np.maximum(gloss, 0.02))
    return {f"gloss {low:g}-{high:g}": 100.0 * band_rms(logs, texels_per_mm, low, high) for low, high in GLOSS_BANDS_MM}


def height_of(slope: Array, texels_per_mm: float) -> Array:
    """(h, w) height in mm whose slopes are nearest in the least-squares sense (Frankot and Chellappa), zero mean.

    Slopes are made periodic by removing their mean and tapering; good enough for wavelengths well below the patch.
    """
    _, h, w = slope.shape
    window = np.outer(np.hanning(h + 2)[1:-1], np.hanning(w + 2)[1:-1])
    p, q = ((s - s.mean()) * window for s in slope)
    u = 2 * np.pi * np.fft.fftfreq(w)[None] * texels_per_mm
    v = -2 * np.pi * np.fft.fftfreq(h)[:, None] * texels_per_mm
    power = u**2 + v**2
    power[0, 0] = 1.0
    spectrum = (-1j * u * np.fft.fft2(p) - 1j * v * np.fft.fft2(q)) / power
    spectrum[0, 0] = 0.0
    return np.asarray(np.fft.ifft2(spectrum).real)


def correlation(a: Array, b: Array) -> float:
    """Pearson's correlation; 0 where either does not vary."""
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return float((a * b).sum() / size) if size > 1e-12 else 0.0


def describe(patch: Patch) -> dict[str, float]:
    """All numbers of a patch, by name."""
    ppm = patch.texels_per_mm
    tone = log_luminance(patch.albedo)
    values = lab(patch.albedo)
    result = {
        "L*": float(values[..., 0].mean()), "a*": float(values[..., 1].mean()), "b*": float(values[..., 2].mean()),
        "ITA": float(typology_angle(patch.albedo.mean((0, 1)))), "sd L*": float(values[..., 0].std()),
        "sd a*": float(values[..., 1].std()), "sd b*": float(values[..., 2].std()),
    }  # fmt: skip
    for low, high in BANDS_MM:
        result[f"albedo {low:g}-{high:g}"] = 100.0 * band_rms(tone, ppm, low, high)
    if patch.gloss is not None:
        result |= gloss_bands(patch.gloss, ppm)
    if patch.slope is None:
        return result
    normal_z = 1.0 / np.sqrt(1.0 + (patch.slope**2).sum(0))
    result["tilt deg"] = float(np.degrees(np.arccos(np.clip(normal_z, -1, 1))).mean())
    for low, high in BANDS_MM:
        along, across = (band_rms(s, ppm, low, high) for s in patch.slope)
        result[f"slope {low:g}-{high:g}"] = 100.0 * float(np.hypot(along, across))
    height = height_of(patch.slope, ppm)
    for low, high in BANDS_MM:
        if np.isfinite(result[f"slope {low:g}-{high:g}"]):
            value = correlation(band(tone, ppm, low, high), band(height, ppm, low, high))
            result[f"corr {low:g}-{high:g}"] = value
    return result
