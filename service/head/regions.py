"""The head's soft vertex masks by name; imported heads have fewer of them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.head.model import HeadModel

Float = npt.NDArray[np.float32]


def vertex_mask(head: HeadModel, *names: str) -> Float:
    """(V,) float32 largest of the named soft regions; 0 where the head has none of them (imported heads have fewer)."""
    found = [head.region(name) for name in names if name in head.region_names]
    return np.asarray(np.max(found, 0) if found else np.zeros(len(head.mean)), np.float32)
