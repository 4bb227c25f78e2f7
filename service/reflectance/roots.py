"""The shadow of hair's roots (``service.texture.roots``) on the diffuse albedo."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.colour import FULL_CODE, Codes, linear_to_srgb, srgb_to_linear
from service.reflectance.texels import interpolated

STRIP = 256
"""Rows of the full map at a time."""


def darkened(albedo: Codes, left: npt.NDArray[np.uint8]) -> Codes:
    """The albedo, changed in place.

    Args:
        albedo: (H, W, 3) sRGB codes.
        left: (h, w, 3) uint8, linear, 255 = 1: the factor on linear albedo, interpolated.
    """
    height, width = albedo.shape[:2]
    planes = np.ascontiguousarray(np.moveaxis(left, 2, 0), np.float32) / np.float32(255)
    columns = np.arange(width)
    for top in range(0, height, STRIP):
        rows = np.arange(top, min(top + STRIP, height))
        factor = np.stack([interpolated(plane, (width, height), rows, columns) for plane in planes], 2)
        chosen = factor.min(2) < 1 - 1e-3
        if chosen.any():
            strip = albedo[rows[0] : rows[-1] + 1]
            linear = srgb_to_linear(strip[chosen] * np.float32(1 / FULL_CODE))
            strip[chosen] = np.rint(linear_to_srgb(linear * factor[chosen]) * FULL_CODE).astype(albedo.dtype)
    return albedo
