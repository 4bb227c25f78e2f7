"""The edges of the eyelids: rows of vertices over their thickness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.head.model import HeadModel

Index = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

ROWS = 5
"""Rows over the thickness of a lid."""


@dataclass(frozen=True)
class LidEdges:
    """Rows of vertices along the edges of one eye's lids, from the socket outwards.

    Lids are thick, and which row of an edge bounds the opening depends on where it is seen from.
    """

    upper: tuple[Index, ...]
    lower: tuple[Index, ...]

    @classmethod
    def of(cls, head: HeadModel, side: str) -> LidEdges | None:
        """None where the head does not name lids and sockets, or one of the lids has no edge."""
        needed = ("eye_socket", f"eyelid_upper_{side}", f"eyelid_lower_{side}")
        if any(name not in head.region_names for name in needed):
            return None
        socket, upper, lower = (head.region(name) for name in needed)
        corners = head.triangles[head.triangle_part == head.part_names.index("skin")]
        found = cls(_rows(corners, socket > 0.5, upper > 0.5), _rows(corners, socket > 0.5, lower > 0.5))
        return found if found.upper and found.lower else None


def _rows(
    corners: npt.NDArray[np.int32], inside: npt.NDArray[np.bool_], lid: npt.NDArray[np.bool_]
) -> tuple[Index, ...]:
    """Up to ``ROWS`` rows of a lid's vertices, each next to the one before, the first next to the inside."""
    rows: list[Index] = []
    taken = inside.copy()
    while len(rows) < ROWS:
        reached = np.unique(corners[taken[corners].any(1)])
        row = reached[lid[reached] & ~taken[reached]].astype(np.int64)
        if not len(row):
            break
        rows.append(row)
        # What was reached beyond the corner of the eye belongs to the other lid's rows.
        taken[reached] = True
    return tuple(rows)
