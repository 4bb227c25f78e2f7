"""What parts are painted on: one part's texels of the chart, or a picture of a mesh's own; where hair grows on it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.arrays import AnyFloat, AnyInt, Float32, Float64, Int64, UInt8
from service.colour import linear_to_srgb
from service.geometry.chart import Chart, nearest_inside
from service.geometry.raster import rasterise
from service.head.files import split_polygons
from service.head.regions import lid_edges, vertex_mask


def part_points(chart: Chart, index: int, texels: Int64) -> tuple[AnyFloat, AnyFloat]:
    """(n, 3) points of texels and (M, 3) vertices of part ``index``, metres on the neutral mean head."""
    head = chart.head
    points = np.einsum("nk,nki->ni", chart.weights[texels], head.mean[chart.corners[texels]])
    return points, head.mean[np.unique(head.triangles[head.triangle_part == index])]


class Canvas:
    """A square picture; texels that no face covers take the colour of the nearest one that is covered."""

    def __init__(self, size: int) -> None:
        """Empty, with sides of so many texels."""
        self.size = size
        self.colour: Float32 = np.zeros((size * size, 3), np.float32)
        self.covered = np.zeros(size * size, bool)

    def texels(self, uv: AnyFloat, uv_faces: AnyInt, faces: AnyInt, values: AnyFloat) -> tuple[Int64, Float64]:
        """(n,) texels that faces cover, row by row, and (n, C) the values (N, C) of their vertices there.

        ``uv_faces`` (F, 3) or (F, 4) are indices into ``uv`` (U, 2), origin bottom left; ``faces`` the same into the
        values.
        """
        places, corners = split_polygons(uv_faces), split_polygons(faces)
        flat = np.stack([uv[:, 0] * self.size, (1 - uv[:, 1]) * self.size], 1).astype(np.float64)
        raster = rasterise(flat, np.zeros(len(flat)), places, self.size, self.size)
        at = np.flatnonzero(raster.mask)
        triangle, weights = raster.triangle.ravel()[at], raster.barycentric.reshape(-1, 3)[at]
        found = np.einsum("nk,nkc->nc", weights.astype(np.float64), np.asarray(values)[corners[triangle]])
        return at.astype(np.int64), found

    def put(self, at: Int64, colour: AnyFloat) -> None:
        """Paint texels (n,) with linear colours (n, 3)."""
        self.colour[at] = colour
        self.covered[at] = True

    def filled(self) -> Float32:
        """(size, size, 3) float32 in [0, 1], linear, row 0 at v = 1."""
        nearest = nearest_inside(self.covered.reshape(self.size, self.size))
        return np.asarray(np.clip(self.colour[nearest], 0, 1), np.float32)

    def picture(self) -> UInt8:
        """(size, size, 3) uint8 sRGB, row 0 at v = 1."""
        return np.asarray(np.rint(255 * linear_to_srgb(self.filled())), np.uint8)


def smooth_noise(places: AnyFloat, scales: Sequence[float], seed: int) -> Float32:
    """(N,) smooth noise about 0 with a standard deviation near 0.5, of points (N, 3) mm: waves of random directions,
    with wave numbers ``scales`` in radians per mm.
    """
    random, total, at = np.random.default_rng(seed), np.zeros(len(places), np.float32), np.asarray(places, np.float32)
    waves = 6
    for scale in scales:
        axes, phase = random.normal(0, scale, (waves, 3)), random.uniform(0, 2 * np.pi, waves)
        total += np.cos(at @ axes.T.astype(np.float32) + phase.astype(np.float32)).sum(1)
    return np.asarray(total / np.float32(np.sqrt(2.0 * waves * len(scales))))


REACH = 1 / 192
"""How far a person's brows may lie from the head model's, as a share of the chart's width: 2 mm."""


def brow_plane(chart: Chart) -> Float32:
    """(h, w) float32 mask in [0, 1]: the head's brow regions dilated by ``REACH``; all 0 if it names none."""
    import cv2

    radius = max(round(chart.width * REACH), 1)
    soft = chart.interpolate(vertex_mask(chart.head, "brow_left", "brow_right")[:, None])[..., 0] * chart.mask
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    # Value of the model's soft mask from which the result is 1.
    return np.asarray(cv2.dilate(np.clip(soft / np.float32(0.3), 0, 1).astype(np.float32), kernel))


def lid_skin(chart: Chart) -> Float32:
    """(h, w) float32 >= 0: weight of the eyelids; 0 where the head names none."""
    weight = chart.interpolate(vertex_mask(chart.head, "eyelid_left", "eyelid_right"))[..., 0]
    return np.asarray(weight * chart.mask, np.float32)


UPPER = (0.0, 0.25, 0.75, 0.6, 0.15)
LOWER = (0.0, 0.1, 0.35, 0.3, 0.1)
"""Density on the rows of vertices over the lid's thickness, from the socket outwards. The row at the socket stays
flesh; lower lashes are shorter, and stand before a pale rim."""


def lash_line(chart: Chart) -> Float32:
    """(N,) density of lashes at the inner texels, in [0, 1]; all 0 for heads that name no lids."""
    weight = np.zeros((len(chart.head.mean), 1), np.float32)
    for side in ("left", "right"):
        edges = lid_edges(chart.head, side)
        for rows, opacity in () if edges is None else ((edges.upper, UPPER), (edges.lower, LOWER)):
            for row, share in zip(rows, opacity, strict=False):
                weight[row, 0] = np.maximum(weight[row, 0], share)
    return np.asarray(chart.inside(weight)[:, 0], np.float32)
