"""Some random heads, on which what is linear in the mean head is tried."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]

HEADS, SEED = 12, 11


def some_heads(identity: Float) -> Float:
    """(HEADS, K) coefficients, standard normal, for components (K, V, 3)."""
    return np.random.default_rng(SEED).normal(size=(HEADS, len(identity)))
