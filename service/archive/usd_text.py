"""Arrays as USD text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.arrays import AnyFloat, AnyInt


def tuples(rows: AnyFloat | Sequence[AnyFloat], digits: int) -> str:
    """Rows (N, C) as "(a, b), (c, d)" with so many significant digits."""
    values = np.asarray(rows, np.float64) + 0.0  # -0.0 becomes 0.0
    number = f"%.{digits}g"
    pattern = "(" + ", ".join([number] * values.shape[1]) + ")"
    return ", ".join([pattern] * len(values)) % tuple(values.ravel().tolist())


def integers(values: AnyInt) -> str:
    """Integers of any shape, flat, as "a, b"."""
    return ", ".join(map(str, np.asarray(values).ravel().tolist()))
