"""The edges of eyelids and lips: rows of vertices over their thickness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.head.model import HeadModel

Index = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

ROWS = 5
"""Rows over the thickness of a lid or a lip."""
JAW_SHARE = 0.25
"""Share of the largest drop with the jaw from which on a lip is the lower one."""


@dataclass(frozen=True)
class OpeningEdges:
    """Rows of vertices along both edges of an opening, from inside outwards.

    Lids and lips are thick, and which row of an edge bounds the opening depends on where it is seen from.
    """

    upper: tuple[Index, ...]
    lower: tuple[Index, ...]


def lid_edges(head: HeadModel, side: str) -> OpeningEdges | None:
    """Of the lids of the left or right eye; None where the head does not name lids and sockets, or one has no edge."""
    needed = ("eye_socket", f"eyelid_upper_{side}", f"eyelid_lower_{side}")
    if any(name not in head.region_names for name in needed):
        return None
    socket, upper, lower = (head.region(name) > 0.5 for name in needed)
    return _edges(head, socket, upper, lower)


def lip_edges(head: HeadModel) -> OpeningEdges | None:
    """Of the lips; None where the head names no lips or lining, or cannot open its jaw."""
    if "lips" not in head.region_names or "mouth_inner" not in head.region_names:
        return None
    if "jawOpen" not in head.expression_names:
        return None
    drop = -head.expression[head.expression_names.index("jawOpen")][:, 1]
    lower, lips = drop > JAW_SHARE * float(drop.max()), head.region("lips") > 0.25
    return _edges(head, head.region("mouth_inner") > 0.5, lips & ~lower, lips & lower)


def _edges(head: HeadModel, inside: Mask, upper: Mask, lower: Mask) -> OpeningEdges | None:
    corners = head.triangles[head.triangle_part == head.part_names.index("skin")]
    found = OpeningEdges(_rows(corners, inside, upper), _rows(corners, inside, lower))
    return found if found.upper and found.lower else None


def _rows(corners: npt.NDArray[np.int32], inside: Mask, own: Mask) -> tuple[Index, ...]:
    """Up to ``ROWS`` rows of vertices of one's own, each next to the one before, the first next to the inside."""
    rows: list[Index] = []
    taken = inside.copy()
    while len(rows) < ROWS:
        reached = np.unique(corners[taken[corners].any(1)])
        row = reached[own[reached] & ~taken[reached]].astype(np.int64)
        if not len(row):
            break
        rows.append(row)
        # What was reached beyond the corner belongs to the other edge's rows.
        taken[reached] = True
    return tuple(rows)
