"""Thickness of the flesh under the skin: how far it is to the other side of an ear, a nostril, a lid."""

from __future__ import annotations

import numpy as np

from service.arrays import AnyFloat, Float32
from service.geometry.normals import vertex_normals
from service.head.model import HeadModel
from service.head.regions import part_vertices

LARGEST_MM = 25.5
"""Thickness from which on it is called thick: hardly any light comes through."""

LEAST_COSINE = 0.3
"""Least cosine between the inward normal and the way to a point that bounds the ball. A neighbour on the same smooth
side has a smaller one, and only says how the surface is curved there, with the error of its normal."""

_BLOCK = 512
"""Vertices that are compared with all others at once."""


def thickness_mm(head: HeadModel, vertices: AnyFloat) -> Float32:
    """(V,) float32 diameter in mm of the largest ball under each vertex of the skin, at most ``LARGEST_MM``.

    Other parts than the skin have ``LARGEST_MM``.

    The ball touches the surface at p with inward normal m, and holds no other vertex: of all q, its radius is the least
    |q - p|^2 / (2 m.(q - p)) (the shrinking ball of Ma, Bae and Choi 2012, solved over all points at once).

    Args:
        head: topology; the skin is its first part.
        vertices: (V, 3) metres.
    """
    result = np.full(len(vertices), LARGEST_MM, np.float32)
    own = part_vertices(head, head.part_names[0]) if head.part_names else np.zeros(0, np.int32)
    if not len(own):
        return result
    points = np.asarray(vertices, np.float64)[own] * 1e3
    inward = -vertex_normals(vertices, head.triangles)[own]
    centred = (points - points.mean(0)).astype(np.float32)
    m = inward.astype(np.float32)
    square = np.einsum("ni,ni->n", centred, centred)
    for first in range(0, len(own), _BLOCK):
        p, direction = centred[first : first + _BLOCK], m[first : first + _BLOCK]
        distance2 = np.maximum(square[first : first + _BLOCK, None] + square - 2 * p @ centred.T, 0)
        along = direction @ centred.T - np.einsum("ni,ni->n", direction, p)[:, None]
        facing = along > LEAST_COSINE * np.sqrt(distance2)
        facing &= distance2 > 1e-4  # not the vertex itself
        diameter = np.where(facing, distance2 / np.where(facing, along, 1), LARGEST_MM)
        result[own[first : first + _BLOCK]] = np.minimum(diameter.min(1), LARGEST_MM)
    return result
