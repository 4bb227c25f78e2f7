"""Directions on the sphere: latitude-longitude images, evenly spread directions, and resampling to these.

Directions are in head space: +X the subject's left, +Y up, +Z out of the face. A latitude-longitude image has +Y at its
top and the direction +Z, from where light falls on the face, at its middle column; a column further right is nearer to
+X.
"""

from __future__ import annotations

import functools

import numpy as np

from service.arrays import AnyFloat, Float32, Float64

GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
"""Radians between successive points of a Fibonacci spiral."""


@functools.lru_cache(maxsize=8)
def pixel_directions(height: int, width: int) -> Float64:
    """(height, width, 3) unit directions of the pixel centres."""
    theta = (np.arange(height) + 0.5) / height * np.pi
    phi = ((np.arange(width) + 0.5) / width - 0.5) * 2.0 * np.pi
    sine, cosine = np.sin(theta)[:, None], np.cos(theta)[:, None]
    flat = np.ones_like(phi)[None]
    return np.stack([sine * np.sin(phi), cosine * flat, sine * np.cos(phi)], -1)


@functools.lru_cache(maxsize=8)
def pixel_solid_angles(height: int, width: int) -> Float64:
    """(height, width) steradians, exact, sum 4 pi."""
    edges = np.cos(np.arange(height + 1) / height * np.pi)
    return np.broadcast_to(((edges[:-1] - edges[1:]) * 2.0 * np.pi / width)[:, None], (height, width))


def pixel_of(directions: Float64, height: int, width: int) -> Float64:
    """(..., 2) row and column, pixel centres at whole numbers, of unit directions (..., 3)."""
    d = np.asarray(directions, np.float64)
    theta = np.arccos(np.clip(d[..., 1], -1.0, 1.0))
    phi = np.arctan2(d[..., 0], d[..., 2])
    return np.stack([theta / np.pi * height - 0.5, (phi / (2.0 * np.pi) + 0.5) * width - 0.5], -1)


@functools.lru_cache(maxsize=8)
def spread_directions(count: int) -> Float64:
    """(count, 3) unit directions, evenly spread (Fibonacci spiral about the vertical); each stands for 4 pi / count."""
    y = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    radius = np.sqrt(1.0 - y * y)
    angle = np.arange(count) * GOLDEN_ANGLE
    return np.stack([radius * np.sin(angle), y, radius * np.cos(angle)], 1)


@functools.lru_cache(maxsize=4)
def _sharing(count: int, height: int, width: int) -> Float32:
    """(count, height * width) solid angle of each pixel, distributed over the nearest directions."""
    pixels = pixel_directions(height, width).reshape(-1, 3)
    sharpness = count / 3.0  # a Gaussian about as wide as the directions are apart
    weight = np.exp(sharpness * (spread_directions(count) @ pixels.T - 1.0))
    weight /= weight.sum(0)
    return (weight * pixel_solid_angles(height, width).ravel()).astype(np.float32)


def flux_by_direction(radiance: AnyFloat, count: int) -> Float64:
    """(count, 3) radiance times solid angle of each of ``count`` spread directions, of the same sum as the image's.

    A pixel is distributed over several directions with smooth weights, so that the shadow of a small bright spot does
    not jump from one direction to the next.
    """
    height, width = radiance.shape[:2]
    return np.asarray(_sharing(count, height, width) @ np.asarray(radiance, np.float64).reshape(-1, 3))
