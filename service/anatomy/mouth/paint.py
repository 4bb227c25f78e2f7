"""Teeth, gums, tongue and the mouth's lining: in the photo's colours where it shows them, darker the further in."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.anatomy.eyes.paint import Light
from service.colour import linear_to_srgb, luma, srgb_to_linear
from service.geometry.chart import Chart
from service.ledger import Correction

Float = npt.NDArray[np.float32]
Points = npt.NDArray[np.floating]

TEETH = np.array([0.87, 0.82, 0.73], np.float32)
GUMS = np.array([0.66, 0.42, 0.40], np.float32)
TONGUE = np.array([0.62, 0.36, 0.35], np.float32)
LINING = np.array([0.42, 0.19, 0.18], np.float32)
"""sRGB colours at the front of the mouth, under the light under which a sclera looks like ``parts.SCLERA``."""

HALF_DEPTH_M = {"teeth": 0.028, "tongue": 0.020, "lining": 0.014}
"""Depth behind the front of each at which it is half as bright (sRGB)."""
CROWN_M = (0.0095, 0.0115)
"""Height of a tooth's crown: up to the first all tooth, from the second on all gum."""
NEIGHBOUR_M = 0.005
"""Vertices within this horizontal distance belong to the same tooth."""
WHITEST = (0.96, 0.92)
"""Largest reflectance of teeth in green and blue, over that in red: even bleached ones are yellower."""
LEAST_BRIGHT = (0.60, 0.80)
"""Luma over the measured tooth's below which the photo shows a gap or a shadow, and from which on it shows teeth."""


def shade(depth: npt.NDArray[np.floating], half: float) -> Float:
    """(N, 1) factor in (0, 1] on sRGB values of points (N,) metres behind the front; 1 before it."""
    return np.asarray(1.0 / (1.0 + (np.maximum(depth, 0.0) / half) ** 1.5), np.float32)[:, None]


def crown_share(points: Points, vertices: Points, *, upper: bool) -> Float:
    """(N,) 1 on the crown of a tooth, 0 on the gum; arguments as of :func:`biting_height`."""
    low, high = CROWN_M
    height = biting_height(points, vertices, upper=upper)
    return np.asarray(np.clip((high - height) / (high - low), 0.0, 1.0), np.float32)


def biting_height(points: Points, vertices: Points, *, upper: bool) -> npt.NDArray[np.float64]:
    """(N,) metres from the biting edge towards the gum.

    Args:
        points: (N, 3) metres on a row of teeth.
        vertices: (M, 3) metres of that row; its biting edge is their lowest (upper row) or highest height near a point.
        upper: which row.
    """
    sign = 1.0 if upper else -1.0
    apart = np.linalg.norm(points[:, None, [0, 2]] - vertices[None, :, [0, 2]], axis=2)
    near = apart <= np.maximum(NEIGHBOUR_M, apart.min(1, keepdims=True) + 1e-6)
    edge = np.where(near, sign * vertices[None, :, 1], np.inf).min(1)
    return np.asarray(sign * points[:, 1] - edge)


class Teeth:
    """Where both rows of teeth lie in the chart.

    Attributes:
        own: (n,) positions of their texels among the inner ones.
        depth: (n,) float32 metres behind the foremost tooth of the same row, in the neutral mean head.
        crown: (n,) float32 share of tooth rather than gum.
    """

    def __init__(self, chart: Chart) -> None:
        """For any head; n is 0 where it has no teeth."""
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
        self.own: npt.NDArray[np.int64] = np.concatenate(own) if own else np.zeros(0, np.int64)
        self.depth: Float = np.concatenate(depth) if depth else none
        self.crown: Float = np.concatenate(crown) if crown else none

    def paint(self, tooth: Float, light: Light) -> Float:
        """(n, 3) sRGB with teeth of a given colour at the front."""
        gums = light.on(GUMS)
        flat = gums + self.crown[:, None] * (tooth - gums)
        return np.asarray(flat * shade(self.depth, HALF_DEPTH_M["teeth"]), np.float32)

    def shows(self, colour: Float, tooth: Float) -> Float:
        """(n,) in [0, 1]: how far the photo's colours (n, 3) are tooth rather than gap, shadow or gum line."""
        bright = luma(colour) / max(float(luma(tooth)), 1e-3)
        low, high = LEAST_BRIGHT
        return np.asarray(np.clip((bright - low) / (high - low), 0.0, 1.0), np.float32)


def no_bluer(colour: Float, white: Float) -> Float:
    """(n, 3) sRGB of teeth without what would make them greener or bluer than ``WHITEST``.

    The eyes lie deeper than the front teeth and see more of the skin's own colour; and the brightest teeth are
    overexposed. By the light of the eyes both would be cyan.

    Args:
        colour: (n, 3) sRGB in [0, 1].
        white: (3,) linear RGB, positive, of a white surface in the eyes' light.
    """
    linear = srgb_to_linear(np.clip(colour, 0, 1).astype(np.float32)) / white
    linear[:, 1:] = np.minimum(linear[:, 1:], linear[:, :1] * np.array(WHITEST, np.float32))
    return np.asarray(linear_to_srgb(np.clip(linear * white, 0, 1).astype(np.float32)), np.float32)


def part_points(chart: Chart, index: int, texels: npt.NDArray[np.int64]) -> tuple[Points, Points]:
    """(n, 3) points of texels, and (M, 3) vertices of their part, in metres on the neutral mean head."""
    head = chart.head
    points = np.einsum("nk,nki->ni", chart.weights[texels], head.mean[chart.corners[texels]])
    return points, head.mean[np.unique(head.triangles[head.triangle_part == index])]


def paint_tongue(chart: Chart, index: int, texels: npt.NDArray[np.int64], light: Light) -> Float:
    """(n, 3) sRGB, darker towards the throat."""
    points, vertices = part_points(chart, index, texels)
    return np.asarray(light.on(TONGUE) * shade(vertices[:, 2].max() - points[:, 2], HALF_DEPTH_M["tongue"]), np.float32)


def paint_lining(chart: Chart, mouth: Float, light: Light) -> Float:
    """(N, 3) sRGB of the lining at all inner texels; ``mouth`` (N,) says which are on it."""
    head = chart.head
    own = mouth > 0.5
    depth = np.zeros(len(mouth))
    if own.any():
        z = np.einsum("nk,nk->n", chart.weights[own], head.mean[chart.corners[own], 2])
        depth[own] = z.max() - z
    return np.asarray(light.on(LINING) * shade(depth, HALF_DEPTH_M["lining"]), np.float32)


TOOTH_HUE = Correction(
    name="tooth-hue",
    mends="By the light of the eyes, overexposed teeth come out cyan.",
    source="texture",
)
