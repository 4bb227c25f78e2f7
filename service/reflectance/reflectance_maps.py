"""Result of the reflectance stages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from service import manifest
from service.arrays import Float32, UInt8, UInt16
from service.runtime.networks import RuntimeName

NORMAL_ONE = 32767
"""Code of 1 in the int16 components of normals."""

STEEPEST_Z = 0.17
"""Smallest z of a unit normal, a tilt of 80 degrees: steeper slopes are not meaningful, and 8 bits do not resolve
them."""
MOST_ACROSS = np.float32(np.sqrt(1 - STEEPEST_Z**2))
"""Length of x and y of the steepest normal."""

MID = 32768
SCALE_MM = 5e-5
"""Of displacement: height in mm = (code - MID) * SCALE_MM, in steps of 50 nm over +-1.6 mm, of which +-1 mm is used."""


@dataclass(frozen=True)
class Wrinkle:
    """Relief that units of one group fold.

    Attributes:
        name: of the group, ``service.reflectance.relief.folds.GROUPS``.
        units: their weights in the photo, at which the relief is this.
        normal: (h, w, 2) int16, x and y of unit normals times ``NORMAL_ONE``, tangent space, +Y up; flat where the
            group folds nothing.
    """

    name: str
    units: Mapping[str, float]
    normal: npt.NDArray[np.int16]


@dataclass(frozen=True)
class Reflectance:
    """Maps on the head's chart, (H, W) texels, row 0 = top (v = 1), filled also outside the islands; None: not
    requested.

    Attributes:
        size: (width, height).
        diffuse_albedo: (H, W, 3) uint16, sRGB coded, 65535 = 1.
        albedo_error: (h, w) uint8, 255 = 1: error of the albedo's log luminance that two texels in three stay within;
            as large as the texture at most.
        specular_albedo: (H, W) uint16, linear, 65535 = 1: F0 = 0.04 times it.
        specular_normal: (H, W, 2) int16, x and y of unit normals times ``NORMAL_ONE``, z > 0; tangent space, +Y up.
        diffuse_normal: the same for diffuse light.
        displacement: (H, W) uint16, height along the normal, see ``MID`` and ``SCALE_MM``; padded by nine texels
            beyond the islands, then 0.
        runtime, precision: what most networks ran on.
        engines: runtime and precision of each network that ran, in words, for example "openvino bf16".
        tile: inner side of the tiles, in texels.
        super_resolution: whether the texture was enlarged by a network; else it was resampled.
        fallbacks: codes of what could not run as intended: "bf16-needs-openvino" where the processor would compute
            faster with OpenVINO installed, "texture-resampled" without super-resolution, "unseen-light-halved" where
            the light on skin that no photo shows was found at half the size, "light-from-skin-alone" where neither
            sclera nor teeth, which tell dark skin from dim light, were seen.
        integration: of the displacement.
        wrinkles: relief that the photo's expression folds, which the normals and the displacement are without.
        corrections: those that ran, in order, with the number of texels that each changed.
        detail: what of the fine detail is the photo's; None: there was no photo, or the texture was only resampled.
        timings_s: seconds of each stage.
    """

    size: tuple[int, int]
    diffuse_albedo: UInt16 | None = None
    albedo_error: UInt8 | None = None
    specular_albedo: UInt16 | None = None
    specular_normal: npt.NDArray[np.int16] | None = None
    diffuse_normal: npt.NDArray[np.int16] | None = None
    displacement: UInt16 | None = None
    runtime: RuntimeName = "onnxruntime"
    precision: Literal["fp32", "bf16"] = "fp32"
    tile: int = 0
    super_resolution: bool = False
    fallbacks: tuple[str, ...] = ()
    engines: Mapping[str, str] = field(default_factory=dict)
    integration: manifest.Integration | None = None
    wrinkles: tuple[Wrinkle, ...] = ()
    corrections: tuple[manifest.CorrectionEntry, ...] = ()
    detail: manifest.Detail | None = None
    timings_s: Mapping[str, float] = field(default_factory=dict)


def pack_normals(x: Float32, y: Float32, z: Float32) -> npt.NDArray[np.int16]:
    """(..., 2) int16 codes of x and y of vectors of any length, normalised.

    Vectors without a direction become flat, (0, 0, 1); those steeper than ``STEEPEST_Z`` are limited to it.
    """
    z = np.maximum(z, 0)
    square = x * x + y * y
    length = np.sqrt(square + z * z)
    sound = (length > 1e-3) & (length < np.inf)
    across = np.sqrt(square)
    # Of unit length, and no longer across than the steepest.
    scale = np.minimum(1 / np.where(sound, length, 1), MOST_ACROSS / np.maximum(across, np.float32(1e-6)))
    scale = np.where(sound, scale * np.float32(NORMAL_ONE), 0)
    return np.stack([np.rint(np.where(sound, part, 0) * scale) for part in (x, y)], -1).astype(np.int16)


def pack_slopes(x: Float32, y: Float32) -> npt.NDArray[np.int16]:
    """(..., 2) int16 codes of x and y of unit normals, from x / z and y / z."""
    scale = np.float32(NORMAL_ONE) / np.sqrt(x * x + y * y + 1)
    result = np.zeros((*x.shape, 2), np.int16)
    for axis, part in enumerate((x, y)):
        np.rint(part * scale, out=result[..., axis], casting="unsafe")
    return result


def unpack_normals(codes: npt.NDArray[np.int16] | Float32) -> Float32:
    """(..., 3) float32 unit normals from (..., 2) codes of x and y, or from means of codes; each axis is one block."""
    x, y = (codes[..., axis] * np.float32(1 / NORMAL_ONE) for axis in (0, 1))
    return np.moveaxis(np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0))]), 0, -1)
