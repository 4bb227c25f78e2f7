"""The lining of lips and cheeks keeps before the teeth, in all identities and units; the jaw takes its teeth along.

MakeHuman's units press lips and cheeks through the teeth; all of it is hidden behind the lips. The outside of a row of
teeth is told by the distance of its vertices from the axis of the dental arch; a vertex of the lining that lies farther
out than all teeth near it on the mean head has to stay so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from models.head.bases import Bases
from service.anatomy.items import Inset

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]

AXIS_Z_M = -0.022
"""Depth of the axis of the dental arches, which runs along +Y."""

CLEAR_M = 0.0006
"""Distance of the lining from the teeth."""

WINDOW_RAD, WINDOW_M = 0.20, 0.0045
"""Teeth within this angle about the axis and this height of a vertex are near it; the lining's quads are as large."""

BOUND_M = (0.003, 0.008)
"""Distance from the teeth up to which the lining follows them from head to head, and from which on it is free."""

FLOOR_DROP = 0.2
"""Share of the jaw's largest drop from which lining within the lower arch is the floor of the mouth."""

FLOOR_REACH_M = 0.007
"""Horizontal distance within which gums keep the floor of the mouth below them."""

DOWN_M = {"jawForward": 0.0035, "jawLeft": 0.0020, "jawRight": 0.0020}
"""How far the lower row sinks in units that would push it through the upper one, as a jaw slides on the incisors."""

TONGUE_OUT = {"teeth_lower": 1.0, "tongue": 0.7}
"""Share of the jaw's part in ``tongueOut`` that the lower row and the tongue take."""


@dataclass(frozen=True)
class _Outside:
    """Lining (N,) vertices that lie outside a row of teeth on the mean head."""

    row: Inset
    vertices: Int

    @classmethod
    def of(cls, row: Inset, mean: Float, lining: Int, fitted: Float) -> _Outside:
        reach, place = _reach(_row_at(row, mean - fitted), mean[lining])
        distance = np.hypot(mean[lining, 0], mean[lining, 2] - AXIS_Z_M)
        # Palate and floor of the mouth lie within the arch and have nothing near, or lie deep within.
        return cls(row, lining[place & (distance > reach - 0.003)])

    def lack(self, head: Float, fitted: Float) -> Float:
        """(N, 3) moves away from the axis that bring the vertices of a head (V, 3) outside again."""
        points = head[self.vertices]
        reach, place = _reach(_row_at(self.row, head - fitted), points)
        ray = points - [0.0, 0.0, AXIS_Z_M]
        ray[:, 1] = 0.0
        distance = np.maximum(np.linalg.norm(ray, axis=1), 1e-6)
        missing = np.where(place, np.maximum(reach + CLEAR_M - distance, 0.0), 0.0)
        return np.asarray((missing / distance)[:, None] * ray)


def _row_at(row: Inset, offsets: Float) -> Float:
    return row.rest.astype(np.float64) + row.moved(offsets)


def _reach(teeth: Float, points: Float) -> tuple[Float, npt.NDArray[np.bool_]]:
    """(N,) largest distance from the axis of the teeth near each point, and whether there are any."""
    angle = np.arctan2(teeth[:, 0], teeth[:, 2] - AXIS_Z_M)
    own = np.arctan2(points[:, 0], points[:, 2] - AXIS_Z_M)
    near = (np.abs(angle[None] - own[:, None]) < WINDOW_RAD) & (
        np.abs(teeth[None, :, 1] - points[:, None, 1]) < WINDOW_M
    )
    distance = np.hypot(teeth[:, 0], teeth[:, 2] - AXIS_Z_M)
    reach = np.where(near, distance[None], -np.inf).max(1)
    return np.where(near.any(1), reach, 0.0), near.any(1)


def clear_of_teeth(
    bases: Bases, rows: Sequence[Inset], fitted: Float, lining: Int, members: dict[str, Int],
    expression_names: tuple[str, ...], tongue_jaw: float,
) -> Bases:  # fmt: skip
    """The bases with a lining outside the teeth.

    Args:
        bases: with lips that touch.
        rows: both rows of teeth.
        fitted: (V, 3) metres, the mean head that they were made for.
        lining: vertices of the skin inside the mouth, and of the lips behind the row at which they touch.
        members: vertices of the head's own parts by name.
        expression_names: the 52 units of ARKit.
        tongue_jaw: share of ``jawOpen`` in ``tongueOut``.
    """
    mean, identity, expression = bases.mean.copy(), bases.identity.copy(), bases.expression.copy()
    index = {name: k for k, name in enumerate(expression_names)}
    for unit, down in DOWN_M.items():
        for part in ("teeth_lower", "tongue"):
            expression[index[unit], members[part], 1] -= down
    for part, share in TONGUE_OUT.items():
        expression[index["tongueOut"], members[part]] += (
            share * tongue_jaw * expression[index["jawOpen"], members[part]]
        )
    outside = [_Outside.of(row, mean, lining, fitted) for row in rows]
    lower = next(row for row in rows if "lower" in row.name)
    floor, nearest = _floor(lower, mean, lining, fitted, -expression[index["jawOpen"], :, 1], outside)
    mean[floor, 1] = np.minimum(mean[floor, 1], _below(lower, mean - fitted, mean[floor]))
    for name, k in index.items():
        expression[k, floor] = 0.0 if name == "mouthClose" else lower.moved(expression[k])[nearest]
    for one in outside:
        mean[one.vertices] += one.lack(mean, fitted)
    for one in outside:
        _bind(identity, one, mean, fitted)
    for name, k in index.items():
        base = expression[index["jawOpen"]] if name == "mouthClose" else 0.0
        for _ in range(2):
            for one in outside:
                expression[k, one.vertices] += one.lack(mean + expression[k] + base, fitted)
    return Bases(mean, identity, expression)


def _floor(
    lower: Inset, mean: Float, lining: Int, fitted: Float, drop: Float, outside: Sequence[_Outside]
) -> tuple[Int, Int]:
    """Lining (N,) within the lower arch, which the jaw carries, and the vertex of the row that each follows."""
    teeth = _row_at(lower, mean - fitted)
    before = np.concatenate([one.vertices for one in outside])
    carried = (drop[lining] > FLOOR_DROP * drop.max()) & (mean[lining, 2] > teeth[:, 2].min())
    floor = lining[carried & ~np.isin(lining, before) & (mean[lining, 1] < teeth[:, 1].mean())]
    nearest = [int(((teeth - point) ** 2).sum(1).argmin()) for point in mean[floor]]
    return floor, np.array(nearest, np.int64)


def _below(lower: Inset, offsets: Float, points: Float) -> Float:
    """(N,) height under the gums near each point; infinity where there are none."""
    gums = _row_at(lower, offsets)
    flat = np.hypot(gums[None, :, 0] - points[:, None, 0], gums[None, :, 2] - points[:, None, 2])
    return np.asarray(np.where(flat < FLOOR_REACH_M, gums[None, :, 1], np.inf).min(1) - CLEAR_M)


def _bind(identity: Float, one: _Outside, mean: Float, fitted: Float) -> None:
    """Let the lining near a row follow it from head to head in the direction away from the axis; in place."""
    teeth = _row_at(one.row, mean - fitted)
    points = mean[one.vertices]
    gap = np.array([np.sqrt(((teeth - point) ** 2).sum(1).min()) for point in points])
    share = np.clip((BOUND_M[1] - gap) / (BOUND_M[1] - BOUND_M[0]), 0.0, 1.0)
    nearest = np.array([int(((teeth - point) ** 2).sum(1).argmin()) for point in points])
    ray = points - [0.0, 0.0, AXIS_Z_M]
    ray[:, 1] = 0.0
    ray /= np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), 1e-6)
    for component in identity:
        apart = ((component[one.vertices] - one.row.moved(component)[nearest]) * ray).sum(1)
        component[one.vertices] -= (share * apart)[:, None] * ray
