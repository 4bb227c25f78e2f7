"""Vertices of a head by name: soft masks of regions, and parts; imported heads have fewer of them."""

from __future__ import annotations

import numpy as np

from service.arrays import Float32, Int32
from service.head.model import HeadModel


def vertex_mask(head: HeadModel, *names: str) -> Float32:
    """(V,) float32 largest of the named soft regions; 0 where the head has none of them (imported heads have fewer)."""
    found = [head.region(name) for name in names if name in head.region_names]
    return np.asarray(np.max(found, 0) if found else np.zeros(len(head.mean)), np.float32)


def part_vertices(head: HeadModel, name: str) -> Int32:
    """Vertices of a part of the head, ascending; none where it has no such part."""
    if name not in head.part_names:
        return np.zeros(0, np.int32)
    return np.unique(head.triangles[head.triangle_part == head.part_names.index(name)])
