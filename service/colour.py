"""Colour: sRGB and linear light, CIE L*a*b*, luma.

"sRGB" means coded values in [0, 1] (or uint8), "linear" means values proportional to light, 1 = the display's white.
Source: IEC 61966-2-1 for the coding, ITU-R BT.709 for the primaries, CIE 15 for L*a*b*.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.arrays import Float32

LUMA = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Weights of R, G, B (BT.709), of linear values for luminance or of coded values for luma."""

Codes = npt.NDArray[np.uint16]

FULL_CODE = 65535
"""Colours between stages are 16-bit codes: 8 bits would drown pores, and floats take twice the memory."""

_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
_WHITE = _TO_XYZ.sum(1)  # D65


def srgb_to_linear(coded: npt.NDArray[np.floating]) -> Float32:
    """Linear float32 in [0, 1] of coded values in [0, 1], any shape; values outside are clipped, NaN stays NaN."""
    x = np.clip(np.asarray(coded, np.float32), 0.0, 1.0)
    return np.where(
        x <= 0.04045, x / np.float32(12.92), ((x + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
    )


def linear_to_srgb(linear: npt.NDArray[np.floating]) -> Float32:
    """Coded float32 in [0, 1] of linear values in [0, 1], any shape; values outside are clipped, NaN stays NaN."""
    x = np.clip(np.asarray(linear, np.float32), 0.0, 1.0)
    root = np.float32(1.055) * x ** np.float32(1 / 2.4) - np.float32(0.055)
    return np.where(x <= 0.0031308, x * np.float32(12.92), root)


_LINEAR_OF_BYTE = srgb_to_linear(np.arange(256) / 255)


def bytes_to_linear(pixels: npt.NDArray[np.uint8]) -> Float32:
    """Linear float32 in [0, 1] of uint8 sRGB, any shape."""
    return _LINEAR_OF_BYTE[pixels]


def to_bytes(coded: npt.NDArray[np.floating]) -> npt.NDArray[np.uint8]:
    """Coded values in [0, 1] rounded to uint8; values outside are clipped. NaN must not come in."""
    return np.asarray(np.rint(np.clip(coded, 0.0, 1.0) * 255), np.uint8)


def luma(rgb: npt.NDArray[np.floating]) -> Float32:
    """(...) float32 weighted sum of (..., 3): luminance of linear values, luma of coded ones; the range stays."""
    x = np.asarray(rgb, np.float32)
    return np.asarray(x[..., 0] * LUMA[0] + x[..., 1] * LUMA[1] + x[..., 2] * LUMA[2], np.float32)


def linear_to_lab(linear: npt.NDArray[np.floating]) -> Float32:
    """(..., 3) float32 CIE L*a*b* (D65): L* in [0, 100], a* and b* about [-128, 128], of linear (..., 3) >= 0.

    Negative values are taken as 0.
    """
    xyz = np.maximum(np.asarray(linear, np.float32), 0) @ (_TO_XYZ / _WHITE[:, None]).T.astype(np.float32)
    knee = np.float32((6 / 29) ** 3)
    f = np.where(xyz > knee, np.cbrt(xyz), xyz * np.float32((29 / 6) ** 2 / 3) + np.float32(4 / 29))
    lightness = 116 * f[..., 1] - 16
    return np.stack([lightness, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], -1)


def to_codes(values: Float32) -> Codes:
    """Values in [-1, 1] as codes 0 to 65535; what lies outside is clipped."""
    coded = np.clip(values, -1, 1)
    coded += 1
    coded *= np.float32(FULL_CODE / 2)
    return np.asarray(np.rint(coded, out=coded), np.uint16)


def from_codes(codes: Codes) -> Float32:
    """Inverse of :func:`to_codes`: float32 in [-1, 1]."""
    values = codes.astype(np.float32)
    decode_in_place(values)
    return values


def decode_in_place(values: Float32) -> None:
    """:func:`from_codes` of codes that are float32 already."""
    values *= np.float32(2 / FULL_CODE)
    values -= np.float32(1)
