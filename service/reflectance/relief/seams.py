"""Equal heights at both sides of the chart's seams, where the chart is cut but the surface is not.

Islands are integrated independently, so that heights at both sides of a seam differ. Each side is moved by half of the
difference, fading out over ``REACH_MM``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import Bool, Float32, Float64, Int64
from service.geometry.chart import chart_points
from service.head.model import HeadModel

REACH_MM = 3.0
"""Distance from a seam, on the surface, over which the correction fades out."""

INSET = 0.75
"""Distance from the seam to the texel at which a side's height is read, texels."""


@dataclass(frozen=True)
class Seams:
    """Pairs of texels (N,), as flat indices of a map, at the same point on either side of a seam."""

    one: Int64
    other: Int64

    @classmethod
    def of(cls, head: HeadModel, part: int, mask: Bool) -> Seams:
        """Pairs along all seams of part ``part``, at most a texel apart; both texels are within ``mask``."""
        tall, wide = mask.shape
        ends, inner = _seam_edges(head, part, chart_points(head, wide, tall))
        length = np.sqrt(((ends[:, :, 1] - ends[:, :, 0]) ** 2).sum(2)).max(1)
        count = np.ceil(length).astype(np.int64) + 1
        edge = np.repeat(np.arange(len(count)), count)
        first = np.cumsum(count) - count
        along = ((np.arange(len(edge)) - first[edge] + 0.5) / count[edge])[:, None, None]
        point = ends[edge, :, 0] * (1 - along) + ends[edge, :, 1] * along
        inwards = inner[edge] - point
        distance = np.sqrt((inwards * inwards).sum(2, keepdims=True))
        point = point + inwards * np.minimum(INSET / np.maximum(distance, 1e-9), 1.0)
        column, row = np.moveaxis(np.floor(point).astype(np.int64), 2, 0)
        inside = (column >= 0) & (column < wide) & (row >= 0) & (row < tall)
        flat = np.where(inside, row * wide + column, 0)
        good = (inside & mask.ravel()[flat]).all(1)
        return cls(flat[good, 0], flat[good, 1])


def join(height: Float32, seams: Seams, mask: Bool, texel_mm: Float32) -> Float32:
    """Heights (H, W) mm, equal at both sides of seams; texels further than ``REACH_MM`` from one are unchanged.

    Args:
        height: (H, W) float32 mm.
        seams: pairs of texels of that map.
        mask: (H, W) bool; only texels in the same connected component of it as their side of the seam are changed.
        texel_mm: (h, w) side of a texel of the (H, W) map, on the same chart at any size.
    """
    import cv2

    if not len(seams.one):
        return height
    flat = height.ravel()
    half = 0.5 * (flat[seams.other] - flat[seams.one])
    seeds, of_seed = np.unique(np.concatenate([seams.one, seams.other]), return_inverse=True)
    total = np.bincount(of_seed, np.concatenate([half, -half]), len(seeds))
    value = (total / np.bincount(of_seed, minlength=len(seeds))).astype(np.float32)
    empty = np.ones(mask.shape, np.uint8)
    empty.ravel()[seeds] = 0
    found, label = cv2.distanceTransformWithLabels(empty, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    del empty
    distance, label = np.asarray(found).ravel(), np.asarray(label).ravel()
    owner = np.zeros(int(label.max()) + 1, np.int64)
    owner[label[seeds]] = np.arange(len(seeds))
    near = np.flatnonzero(mask.ravel() & (distance < REACH_MM / max(float(texel_mm.min()), 1e-3)))
    distance, source = distance[near], owner[label[near]]  # frees the full planes, 100 MB each
    del found, label
    region = np.asarray(cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)[1]).ravel()
    same = region[near] == region[seeds[source]]
    del region
    row, column = near // mask.shape[1], near % mask.shape[1]
    scale = np.array(texel_mm.shape) / mask.shape
    mm = texel_mm[(row * scale[0]).astype(int), (column * scale[1]).astype(int)] * distance
    fade = 0.5 * (1 + np.cos(np.pi * np.minimum(mm / REACH_MM, 1.0)))
    result = height.copy()
    result.ravel()[near] += np.where(same, value[source] * fade, 0).astype(np.float32)
    return result


def _seam_edges(head: HeadModel, part: int, points: Float64) -> tuple[Float64, Float64]:
    """Edges whose two triangles are separate on the chart.

    Returns:
        (N, 2, 2, 2) positions in texels by side, end and axis, with ends in the same order at both sides; and
        (N, 2, 2) those of the third corner of each side's triangle.
    """
    chosen = head.triangle_part == part
    vertices, places = head.triangles[chosen].astype(np.int64), head.triangle_uv[chosen].astype(np.int64)
    start = np.concatenate([np.stack([vertices[:, i], places[:, i]], 1) for i in range(3)])
    stop = np.concatenate([np.stack([vertices[:, (i + 1) % 3], places[:, (i + 1) % 3]], 1) for i in range(3)])
    third = np.concatenate([places[:, (i + 2) % 3] for i in range(3)])
    swap = start[:, 0] > stop[:, 0]
    low, high = np.where(swap[:, None], stop, start), np.where(swap[:, None], start, stop)
    key = low[:, 0] * (int(vertices.max(initial=0)) + 1) + high[:, 0]
    order = np.argsort(key, kind="stable")
    _, first, count = np.unique(key[order], return_index=True, return_counts=True)
    pairs = order[first[count == 2][:, None] + np.arange(2)]
    apart = (low[pairs[:, 0], 1] != low[pairs[:, 1], 1]) | (high[pairs[:, 0], 1] != high[pairs[:, 1], 1])
    pairs = pairs[apart]
    ends = np.stack([points[low[pairs, 1]], points[high[pairs, 1]]], 2)
    return ends, points[third[pairs]]
