"""The bases of a head while it is built."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.head.model import HeadModel

Float = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Bases:
    """mean (V, 3), identity (K, V, 3), expression (E, V, 3), metres."""

    mean: Float
    identity: Float
    expression: Float

    @classmethod
    def of(cls, head: HeadModel) -> Bases:
        """Of a head that is there."""
        return cls(*(np.asarray(basis, np.float64) for basis in (head.mean, head.identity, head.expression)))
