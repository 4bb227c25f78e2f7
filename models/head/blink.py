"""A blink that unrolls the upper lid: no crease lies below the shut lid, and its edge is one smooth curve.

The base mesh carries the rows of the open lid down as they lie, so that crease and platform end in a heap on the lower
lid: two dark lines in any light. Here the rows between the lid's edge and the brow share the way: at ``eyeBlink`` 1
they lie on a smooth shell round the eyeball, spaced as they are along the open lid.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.head.lids import Globe, Lids
from models.head.quads import Quads

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]

ROWS = 9
"""Rows of the upper lid before its contact row, up to the bone of the brow; the last keeps a share of its motion."""
MARGIN = 3
"""Rows of them that are the edge itself, two millimetres thick."""
DEGREE = 5
"""Of the polynomials along the opening that the edge follows at 1."""
PLACES = ((0, 1, 0.5), (1, 2, 0.5), (2, 3, 0.5), (2, 3, 0.6))
TUCKED_M = ((-0.0007, -0.0006), (-0.0007, -0.0005), (-0.0002, -0.0008), (0.0, 0.0))
"""Where the rows of the edge end at 1, from the contact row on: between two rows of the lower lid, by a share, and then
up and before it, metres."""
WHOLE_M = 0.005
"""Way of the edge from which on a column lies wholly on the shell; at the corners the lid only follows its edge."""
BULGE = 2.5
"""Power of a row's share of the way by which its distance from the eyeball grows: the lid lies on the ball, the crease
is below the brow."""
THICK_M = 0.0006
"""How much farther from it the middle of the lid is than its edge."""
LINING_M = 0.001
"""Most that the lid's lining keeps from the eyeball at 1, beyond what it must."""
BROW_SHARE = 0.3
"""Share of its motion in the base mesh that the last row keeps: the brow hardly moves in a blink."""


def unrolled(mean: Float, unit: Float, lids: Lids, ball: Int, mesh: Quads) -> Float:
    """(V, 3) offsets of ``eyeBlink`` under which the shut upper lid is smooth.

    Args:
        mean: (V, 3) metres.
        unit: (V, 3) of a blink that ends on the lower lid.
        lids: rows round the eye.
        ball: vertices of the eyeball.
        mesh: the skin.
    """
    globe, out = Globe.of(mean[ball]), unit.copy()
    centre, upper = globe.centre, np.flatnonzero(lids.upper)
    rows = np.array(
        [[int(lids.contact[r]), *mesh.walk(int(lids.contact[r]), int(lids.outer[r, 0]), ROWS)] for r in upper]
    )
    ends = _edges(mean, unit, lids)
    for column, end in zip(rows, ends.swapaxes(0, 1), strict=True):
        rest, own = mean[column], unit[column]
        out[column[: MARGIN + 1]] = end - rest[: MARGIN + 1]
        lid = np.arange(MARGIN, ROWS + 1)
        along = np.cumsum(np.r_[0.0, np.linalg.norm(np.diff(rest[lid], axis=0), axis=1)])
        share = along / along[-1]
        first, last = end[-1], rest[-1] + BROW_SHARE * own[-1]
        shell = _shell(first - centre, last - centre, share) + centre
        whole = _ease(float(np.clip(np.linalg.norm(first - rest[MARGIN]) / WHOLE_M, 0.0, 1.0)))
        out[column[lid[1:]]] += (whole * (shell - rest[lid] - own[lid]))[1:]
    lining = np.unique(lids.inner[upper])
    at = mean[lining] + unit[lining]
    far = np.linalg.norm(at - centre, axis=1) - globe.surface(at) - LINING_M
    out[lining] -= np.maximum(far, 0.0)[:, None] * globe.rays(at)
    return out


def _shell(first: Float, last: Float, share: Float) -> Float:
    """(N, 3) points between two points about the origin: directions along the great circle, distances smoothly."""
    lengths = np.linalg.norm(first), np.linalg.norm(last)
    a, b = first / lengths[0], last / lengths[1]
    angle = float(np.arccos(np.clip(a @ b, -1.0, 1.0)))
    ray = (np.sin((1 - share) * angle)[:, None] * a + np.sin(share * angle)[:, None] * b) / np.sin(angle)
    length = lengths[0] + share**BULGE * (lengths[1] - lengths[0]) + 4 * THICK_M * share * (1 - share)
    return np.asarray(length[:, None] * ray)


def _ease(share: float) -> float:
    return share * share * (3 - 2 * share)


def _edges(mean: Float, unit: Float, lids: Lids) -> Float:
    """(MARGIN + 1, U, 3) the shut edge's rows from the contact row on, each along a polynomial of x.

    The lid's face ends before the lower lid's and is level with it; the rows of the edge are tucked behind that.
    """
    table = np.c_[lids.contact, lids.outer[:, :MARGIN]]
    shut = mean + unit
    below = [lids.across @ shut[table[:, k]] for k in range(MARGIN + 1)]
    corners = np.flatnonzero(~lids.upper)[[np.argmin(below[0][~lids.upper, 0]), np.argmax(below[0][~lids.upper, 0])]]
    chosen = np.r_[corners, np.flatnonzero(lids.upper)]
    weight = np.r_[4.0, 4.0, np.ones(len(chosen) - 2)]
    ends = []
    for (one, other, share), (up, before) in zip(PLACES, TUCKED_M, strict=True):
        at = ((1 - share) * below[one] + share * below[other])[chosen]
        middle, half = 0.5 * (at[:, 0].max() + at[:, 0].min()), 0.5 * np.ptp(at[:, 0])
        place = (at[:, 0] - middle) / half
        for axis in (1, 2):
            at[:, axis] = np.polyval(np.polyfit(place, at[:, axis], DEGREE, w=weight), place)
        fade = np.clip(1 - place**2, 0.0, 1.0) ** 0.25
        at[:, 1] += up * fade
        at[:, 2] += before * fade
        ends.append(at[2:])
    return np.array(ends)
