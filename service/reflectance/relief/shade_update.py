"""Normals corrected by the shade that the photo shows: rho's guess is the prior, the shading equation the measurement.

Light from a direction tells what no network knows that is not told of the light: a slope towards it is brighter. In an
octave of periods, with rho's normal n = (x, y) in tangent space, whose error has the variance r^2 each, and the octave
s of the logarithm of the skin's brightness,

    s = g . n + p,    g = d log E / d n,    n' = n + r^2 g (s - g . n) / (r^2 |g|^2 + p^2)

E is the irradiance of the fitted light (``service.reflectance.subject``) and p the standard deviation of the
octave of log albedo: pigment is noise here. This is one update of Kalman's filter (1960); linear shape from shading
(Pentland 1990) is its case without prior and pigment. Across the light nothing changes.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.arrays import Float32
from service.colour import FULL_CODE, Codes
from service.image_filters import shrunk, stretched_to
from service.reflectance.planes import Planes
from service.reflectance.reflectance_maps import NORMAL_ONE
from service.reflectance.subject import GEOMETRY_SIZE
from service.reflectance.translate import pack_normals
from service.runtime.network_registry import COVERED
from service.texture.photo_sampling import (
    Strip,
    change_strips,
    joined_octaves,
    octave_strips,
    split_octaves,
    stretched,
)

PIGMENT = (0.0193, 0.0211, 0.0235, 0.0243, 0.0289)
"""Standard deviation of log albedo, octave by octave from periods of 2 to 4 texels of ``FULL_WIDTH`` on; measured by
models.lightstage.octaves, as is the next."""
RELIEF = (0.0371, 0.0550, 0.0419, 0.0250, 0.0169)
"""Standard deviation of x and of y of specular normals."""
UNTOLD = 0.98
"""Share of that by which rho errs: sqrt(1 - c^2) with its correlation c of 0.2 (docs/training.md)."""
FULL_WIDTH = 6144
GAMMA = 2.2
"""Of coded brightness, as in ``service.reflectance.relief.normal_inputs``."""
LEAST = 0.02
"""Coded brightness below which logarithms stop."""


def updated(normal: Float32, shade: Float32, slope: Float32, error: float, pigment: float) -> Float32:
    """(h, w, 2) what the update adds to an octave of x and y; 0 where light has no direction.

    Args:
        normal: (h, w, 2) octave of the guessed x and y.
        shade: (h, w) octave of the logarithm of brightness.
        slope: (h, w, 2) g.
        error: standard deviation r of each component of ``normal``.
        pigment: standard deviation p, > 0.
    """
    x, y = slope[..., 0], slope[..., 1]
    surprise = shade - x * normal[..., 0] - y * normal[..., 1]
    gain = error**2 / (error**2 * (x * x + y * y) + pigment**2)
    return np.asarray((gain * surprise)[..., None] * slope, np.float32)


def bare(seen: Float32, planes: Planes) -> Float32:
    """(h, w) float32 in [0, 1] at ``GEOMETRY_SIZE``: how far the photo shows skin there with nothing over it.

    Args:
        seen: (H, W) in [0, 1], how far texels show the photo.
        planes: with ``COVERED``, or all of it counts as bare.
    """
    shown = np.clip(stretched_to(seen, GEOMETRY_SIZE), 0, 1)
    over = planes.shrunk([COVERED], GEOMETRY_SIZE)[0] if COVERED in planes.channels else np.float32(0)
    return np.asarray(shown * (1 - np.clip(over, 0, 1)), np.float32)


def with_shade(normals: npt.NDArray[np.int16], grey: Codes, slope: Float32, trust: Float32,
               shares: tuple[float, ...]) -> npt.NDArray[np.int16]:  # fmt: skip
    """(H, W, 2) codes of normals, changed in place, with what the shade of seen skin tells.

    Args:
        normals: codes of rho's normals.
        grey: (H, W) codes of skin without its smooth light.
        slope: (h, w, 2) g, of any size.
        trust: (h, w) in [0, 1] where ``grey`` is bare skin in the photo's light; smooth, of any size.
        shares: what the photo tells of each octave of this map, finest first (``service.texture.photo_detail``).
    """
    height, width = normals.shape[:2]
    first = max(round(np.log2(FULL_WIDTH / width)), 0)
    weights = [UNTOLD * one for one in RELIEF[first:]]
    octaves = min(len(weights), len(shares))
    if not octaves or not (trust > 0).any():
        return normals
    planes = [np.ascontiguousarray(plane) for plane in (slope[..., 0], slope[..., 1], trust)]

    def changed(one: Strip) -> tuple[npt.NDArray[np.int16], None]:
        bent = one.before * np.float32(1 / NORMAL_ONE)
        coded = one.of(grey) * np.float32(1 / FULL_CODE)
        bands, _ = split_octaves(np.log(np.maximum(coded, np.float32(LEAST))) * np.float32(GAMMA), octaves)
        guess, _ = split_octaves(bent, octaves)
        across = np.dstack([stretched(plane, (width, height), one.window) for plane in planes])
        change = []
        for index, (shade, normal) in enumerate(zip(bands, guess, strict=True)):
            here = shrunk(across, normal.shape[1::-1])
            more = updated(normal, shade, here[..., :2], weights[index], PIGMENT[first + index])
            change.append(np.asarray(more * here[..., 2:] * np.float32(shares[index]), np.float32))
        better = (bent + joined_octaves(change))[one.inside]
        x, y = better[..., 0], better[..., 1]
        codes = pack_normals(x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0)))
        return np.where(across[one.inside][..., 2:] > 0, codes, one.before[one.inside]), None

    change_strips(normals, octave_strips(normals, trust > 0, octaves), changed)
    return normals
