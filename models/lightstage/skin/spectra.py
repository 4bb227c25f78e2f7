"""Optical constants of skin and the standard observer, tabulated every 10 nm from 400 to 720 nm.

Absorption and scattering follow Jacques (omlc.org, "Skin optics", 1998); extinction of haemoglobin Prahl (omlc.org);
the colour matching functions are the Gaussian lobes of Wyman, Sloan and Shirley (JCGT 2013).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

WAVELENGTHS: Array = np.arange(400.0, 721.0, 10.0)

# Molar extinction in cm^-1 / (mol / l).
_HB = (
    "223296 303956 407560 528600 413280 103292 23388.8 16156.4 14550 16684 20862 25773.6 31589.6 39036.4 46592 53412 "
    "53788 45072 37020 28324.4 14677.2 9443.6 6509.6 5148.8 4345.2 3750.12 3226.56 2795.12 2407.92 2051.96 1794.28 "
    "1540.48 1325.88"
)
_HBO2 = (
    "266232 466840 480360 246072 102580 62816 44480 33209.2 26629.2 23684.4 20932.8 20035.2 24202.4 39956.8 53236 "
    "43016 32613.2 44496 50104 14400.8 3200 1506 942 610 442 368 319.6 294 277.6 276 290 314 348"
)
_D65 = (
    "82.75 91.49 93.43 86.68 104.86 117.01 117.81 114.86 115.92 108.81 109.35 107.80 104.79 107.69 104.41 104.05 100 "
    "96.33 95.79 88.69 90.01 89.60 87.70 83.29 83.70 80.03 80.21 82.28 78.28 69.72 71.61 74.35 61.60"
)
_XYZ_TO_RGB = np.array(
    [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ]
)


def _table(text: str) -> Array:
    return np.array([float(word) for word in text.split()])


DEOXYHAEMOGLOBIN = _table(_HB)
OXYHAEMOGLOBIN = _table(_HBO2)
DAYLIGHT = _table(_D65)


def base_absorption() -> Array:
    """(33,) absorption of bloodless, pigment-free tissue, cm^-1."""
    return 0.244 + 85.3 * np.exp(-(WAVELENGTHS - 154.0) / 66.2)


def melanin_absorption(eumelanin: float) -> Array:
    """(33,) absorption of the inside of a melanosome, cm^-1; ``eumelanin`` in [0, 1], the rest is pheomelanin."""
    eu = 6.6e11 * WAVELENGTHS**-3.33
    pheo = 2.9e15 * WAVELENGTHS**-4.75
    return eumelanin * eu + (1.0 - eumelanin) * pheo


def blood_absorption(oxygenation: Array) -> Array:
    """(n, 33) absorption of whole blood (150 g/l haemoglobin), cm^-1, for (n,) oxygenation in [0, 1]."""
    share = np.asarray(oxygenation, np.float64)[:, None]
    return 2.303 * 150.0 / 64500.0 * (share * OXYHAEMOGLOBIN + (1.0 - share) * DEOXYHAEMOGLOBIN)


def reduced_scattering() -> Array:
    """(33,) reduced scattering of the dermis, cm^-1."""
    return 2e5 * WAVELENGTHS**-1.5 + 2e12 * WAVELENGTHS**-4.0


def _lobe(mean: float, below: float, above: float) -> Array:
    width = np.where(mean > WAVELENGTHS, below, above)
    return np.exp(-0.5 * ((WAVELENGTHS - mean) / width) ** 2)


def rgb_weights() -> Array:
    """(33, 3) weights that take a reflectance spectrum to linear sRGB, one for a perfect white under D65."""
    x = 1.056 * _lobe(599.8, 37.9, 31.0) + 0.362 * _lobe(442.0, 16.0, 26.7) - 0.065 * _lobe(501.1, 20.4, 26.2)
    y = 0.821 * _lobe(568.8, 46.9, 40.5) + 0.286 * _lobe(530.9, 16.3, 31.1)
    z = 1.217 * _lobe(437.0, 11.8, 36.0) + 0.681 * _lobe(459.0, 26.0, 13.8)
    xyz = np.stack([x, y, z], 1) * DAYLIGHT[:, None]
    rgb = xyz @ _XYZ_TO_RGB.T
    return np.asarray(rgb / rgb.sum(0))
