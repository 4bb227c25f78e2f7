"""The head's soft vertex masks by name."""

from __future__ import annotations

import numpy as np

from service.arrays import Float32
from service.head.model import HeadModel


def vertex_mask(head: HeadModel, *names: str) -> Float32:
    """(V,) float32 largest of the named soft regions; 0 where the head has none of them (imported heads have fewer)."""
    found = [head.region(name) for name in names if name in head.region_names]
    return np.asarray(np.max(found, 0) if found else np.zeros(len(head.mean)), np.float32)
