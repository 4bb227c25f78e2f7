"""From radiance samples to a PNG: pixel filter, background, tone curve."""

from __future__ import annotations

import numpy as np

from service.archive.images import encode_png
from service.arrays import AnyFloat, Float32, Int64
from service.colour import to_bytes
from service.geometry.camera import Camera
from service.geometry.normals import normalise
from service.light.environment import lookup
from service.light.scene import Response
from service.light.shading import develop

_BAND = 64
"""Rows of the background computed at once."""


def resolved(
    radiance: Float32, index: Int64, shape: tuple[int, int], supersampling: int, before: Float32 | None = None
) -> tuple[Float32, Float32]:
    """Mean of the samples of each pixel (box filter).

    Args:
        radiance: (N, 3) of the samples on the head.
        index: (N,) flat positions of these samples.
        shape: rows and columns of samples.
        supersampling: samples per pixel and axis.
        before: (rows * columns, 4) radiance times coverage, and coverage, of what stands before the head in each
            sample; None: nothing.

    Returns:
        (h, w, 3) linear radiance times coverage, and (h, w) coverage of the pixel in [0, 1].
    """
    samples = np.zeros((shape[0] * shape[1], 4), np.float32)
    samples[index, :3], samples[index, 3] = radiance, 1.0
    if before is not None:
        samples *= 1 - before[:, 3:]
        samples += before
    split = (shape[0] // supersampling, supersampling, shape[1] // supersampling, supersampling, 4)
    mean = samples.reshape(split).mean((1, 3))
    return mean[..., :3], mean[..., 3]


def behind(camera: Camera, environment: AnyFloat) -> Float32:
    """(h, w, 3) linear radiance of a latitude-longitude image in the direction of each pixel."""
    result = np.zeros((camera.height, camera.width, 3), np.float32)
    x = (np.arange(camera.width) + 0.5 - camera.principal_point[0]) / camera.focal_px
    for first in range(0, camera.height, _BAND):
        rows = np.arange(first, min(first + _BAND, camera.height))
        y = (rows + 0.5 - camera.principal_point[1]) / camera.focal_px
        plane = np.stack([*np.broadcast_arrays(x[None, :], y[:, None]), np.ones((len(rows), len(x)))], -1)
        result[rows[0] : rows[-1] + 1] = lookup(np.asarray(environment, np.float64), normalise(plane @ camera.rotation))
    return result


def coded(light: Float32, covered: Float32, response: Response, background: Float32 | None, *, alpha: bool) -> bytes:
    """PNG bytes, 8-bit sRGB.

    Args:
        light: (h, w, 3) linear, as from :func:`resolved`.
        covered: (h, w) in [0, 1].
        response: tone curve, with a number for its exposure.
        background: (h, w, 3) linear radiance behind the head; None for none.
        alpha: add ``covered`` as alpha channel; colours are then not premultiplied.
    """
    if alpha:
        whole = light / np.maximum(covered, np.float32(1e-6))[..., None]
        colour = to_bytes(develop(whole.astype(np.float64), response) * (covered > 0)[..., None])
        return encode_png(np.dstack([colour, to_bytes(covered)]), srgb=True)
    behind_it = 0.0 if background is None else (1 - covered)[..., None] * background
    return encode_png(to_bytes(develop((light + behind_it).astype(np.float64), response)), srgb=True)
