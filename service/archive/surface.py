"""Parts of the head with one index per vertex, and the vertex normals of all meshes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, AnyInt, Float32, Int64
from service.geometry.normals import FALLBACK_NORMAL, area_normals, normalise
from service.head.model import HeadModel
from service.materials.part import MeshPart

__all__ = ["FALLBACK_NORMAL", "Part", "is_cards", "part_normals", "split_parts", "vertex_normals"]

vertex_normals = area_normals
"""The normals of all meshes in the archive but masked cards."""
ROUND = 0.6
"""Share of the direction from the part's middle in the normals of masked cards."""


def is_cards(part: MeshPart) -> bool:
    """Whether a part is masked cards, which are lit with other normals than those of their surface."""
    return part.material.alpha == "mask"


def part_normals(part: MeshPart, vertices: AnyFloat, triangles: AnyInt) -> Float32:
    """(..., N, 3) unit normals that a part is lit with.

    Those of its surface; of masked cards, which lie at all angles, those of the body that they make up: with their own,
    hair has facets and slits.

    Args:
        part: whose material says whether it is cards.
        vertices: (..., N, 3) metres, of any number of poses.
        triangles: (T, 3) its faces.
    """
    normals = area_normals(vertices, triangles)
    if not is_cards(part):
        return normals
    points = np.asarray(vertices, np.float64)
    away = normalise(points - points.mean(-2, keepdims=True), (0.0, 1.0, 0.0))
    outward = np.where((normals * away).sum(-1, keepdims=True) < 0, -normals, normals)
    return np.asarray(normalise((1 - ROUND) * outward + ROUND * away, (0.0, 1.0, 0.0)), np.float32)


@dataclass(frozen=True)
class Part:
    """One part of the head with vertices split at the cuts of the chart.

    Attributes:
        name: of ``HeadModel.part_names``.
        vertex: (N,) int64 head vertex of each split vertex.
        uv: (N,) int64 index into ``HeadModel.uv``.
        triangles: (M, 3) int64 indices below N, counter-clockwise from outside.
    """

    name: str
    vertex: Int64
    uv: Int64
    triangles: Int64


def split_parts(head: HeadModel) -> list[Part]:
    """Every part that has triangles, in the order of ``part_names``; N is as small as the cuts of the chart allow."""
    parts = []
    for index, name in enumerate(head.part_names):
        chosen = head.triangle_part == index
        if not chosen.any():
            continue
        pairs = head.triangles[chosen].astype(np.int64) * len(head.uv) + head.triangle_uv[chosen]
        unique, local = np.unique(pairs, return_inverse=True)
        parts.append(Part(name, unique // len(head.uv), unique % len(head.uv), local.reshape(-1, 3)))
    return parts
