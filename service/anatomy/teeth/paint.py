"""Texels of the teeth on the chart, and their albedo by the colour that the photo shows."""

from __future__ import annotations

import numpy as np

from service.anatomy.mouth.paint import part_points, shade
from service.anatomy.teeth.colours import GUMS, WHITEST
from service.arrays import AnyFloat, Float32, Float64, Int64
from service.colour import linear_to_srgb, luma, srgb_to_linear
from service.geometry.chart import Chart

HALF_DEPTH_M = 0.028
"""Metres behind the front tooth at which a tooth's sRGB values have halved."""

CROWN_M = (0.0095, 0.0115)
"""Metres from the incisal edge: up to the first all is crown, from the second on all is gum."""

NEIGHBOUR_M = 0.005
"""Vertices within this horizontal distance, metres, belong to the same tooth."""

BRIGHT = (0.60, 0.80)
"""Luma over the measured tooth's up to which the photo shows a gap or a shadow, and from which on it shows teeth."""


def crown_share(points: AnyFloat, vertices: AnyFloat, *, upper: bool) -> Float32:
    """(N,) in [0, 1], 1 on the crown of a tooth, 0 on the gum; arguments as of :func:`biting_height`."""
    low, high = CROWN_M
    height = biting_height(points, vertices, upper=upper)
    return np.asarray(np.clip((high - height) / (high - low), 0.0, 1.0), np.float32)


def biting_height(points: AnyFloat, vertices: AnyFloat, *, upper: bool) -> Float64:
    """(N,) metres from the incisal edge towards the gum.

    Args:
        points: (N, 3) metres on a row of teeth.
        vertices: (M, 3) metres of that row; its edge near a point is the lowest of them (upper row) or the highest.
        upper: whether it is the upper row.
    """
    sign = 1.0 if upper else -1.0
    distance = np.linalg.norm(points[:, None, [0, 2]] - vertices[None, :, [0, 2]], axis=2)
    near = distance <= np.maximum(NEIGHBOUR_M, distance.min(1, keepdims=True) + 1e-6)
    edge = np.where(near, sign * vertices[None, :, 1], np.inf).min(1)
    return np.asarray(sign * points[:, 1] - edge)


class Teeth:
    """Both rows of teeth on the chart.

    Attributes:
        own: (n,) int64 indices of their texels among the inner ones.
        depth: (n,) float32 metres behind the foremost tooth of the same row, in the neutral mean head.
        crown: (n,) float32 in [0, 1], 1 on crowns and 0 on gums.
    """

    def __init__(self, chart: Chart) -> None:
        """Of any head; n is 0 where it has no teeth."""
        own, depth, crown = [], [], []
        for index, name in enumerate(chart.head.part_names):
            texels = np.flatnonzero(chart.inner_part == index)
            if not name.startswith("teeth") or not len(texels):
                continue
            points, vertices = part_points(chart, index, texels)
            own.append(texels)
            depth.append((vertices[:, 2].max() - points[:, 2]).astype(np.float32))
            crown.append(crown_share(points, vertices, upper=not name.endswith("lower")))
        none = np.zeros(0, np.float32)
        self.own: Int64 = np.concatenate(own) if own else np.zeros(0, np.int64)
        self.depth: Float32 = np.concatenate(depth) if depth else none
        self.crown: Float32 = np.concatenate(crown) if crown else none

    def paint(self, tooth: Float32) -> Float32:
        """(n, 3) sRGB-coded albedo: teeth of a sRGB-coded colour (3,) at the front, darker the deeper they lie."""
        gums = linear_to_srgb(GUMS)
        flat = gums + self.crown[:, None] * (tooth - gums)
        return np.asarray(flat * shade(self.depth, HALF_DEPTH_M), np.float32)

    def shows(self, colour: Float32, tooth: Float32) -> Float32:
        """(n,) in [0, 1]: how far the photo's sRGB colours (n, 3) are tooth (3,) rather than gap, shadow or gum."""
        bright = luma(colour) / max(float(luma(tooth)), 1e-3)
        low, high = BRIGHT
        return np.asarray(np.clip((bright - low) / (high - low), 0.0, 1.0), np.float32)


def no_bluer(albedo: Float32) -> Float32:
    """(n, 3) sRGB-coded albedo of teeth whose green and blue over red are at most ``WHITEST``.

    Without this limit teeth can come out cyan: the sclera, which gives the light, lies deeper than the front teeth and
    receives more light reflected by skin; and the brightest teeth are overexposed.
    """
    linear = srgb_to_linear(albedo)
    linear[:, 1:] = np.minimum(linear[:, 1:], linear[:, :1] * np.array(WHITEST, np.float32))
    return linear_to_srgb(linear)
