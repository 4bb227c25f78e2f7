"""Parts of the head with one index per vertex, and the vertex normals of all meshes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import Int64
from service.geometry.normals import FALLBACK_NORMAL, area_normals
from service.head.model import HeadModel

__all__ = ["FALLBACK_NORMAL", "Part", "split_parts", "vertex_normals"]

vertex_normals = area_normals
"""The normals of all meshes in the archive."""


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
