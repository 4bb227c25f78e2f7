"""Vertices of a head by name: soft masks of regions, parts, eyeballs, and rows along the edges of lids and lips."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, Bool, Float32, Float64, Int32, Int64
from service.head.model import HeadModel


def vertex_mask(head: HeadModel, *names: str) -> Float32:
    """(V,) float32 largest of the named soft regions; 0 where the head has none of them (imported heads have fewer)."""
    found = [head.region(name) for name in names if name in head.region_names]
    return np.asarray(np.max(found, 0) if found else np.zeros(len(head.mean)), np.float32)


def part_vertices(head: HeadModel, name: str) -> Int32:
    """Vertices of a part of the head, ascending; none where it has no such part."""
    if name not in head.part_names:
        return np.zeros(0, np.int32)
    found = np.zeros(len(head.mean), bool)
    found[head.triangles[head.triangle_part == head.part_names.index(name)]] = True
    return np.flatnonzero(found).astype(np.int32)


ROWS = 5
"""Rows across the thickness of a lid or a lip."""

JAW_SHARE = 0.25
"""A vertex of the lips is of the lower lip if ``jawOpen`` lowers it by over this share of its largest drop."""


@dataclass(frozen=True)
class OpeningEdges:
    """Rows of vertex indices along both edges of an opening, from inside outwards.

    Lids and lips are thick: which row of an edge bounds the opening depends on the direction of view.
    """

    upper: tuple[Int64, ...]
    lower: tuple[Int64, ...]

    def height(self, vertices: AnyFloat) -> float:
        """Height of the opening in its middle along y, in the unit of vertices (V, 3); negative where edges overlap."""
        x = vertices[np.concatenate(self.upper + self.lower), 0]
        middle = 0.5 * (float(x.min()) + float(x.max()))
        upper, lower = ([_at(vertices[row], middle) for row in rows] for rows in (self.upper, self.lower))
        return min(upper) - max(lower)


def _at(row: AnyFloat, x: float) -> float:
    """Y of a row (N, 3) at x."""
    line = row[np.argsort(row[:, 0])]
    return float(np.interp(x, line[:, 0], line[:, 1]))


def lid_edges(head: HeadModel, side: str) -> OpeningEdges | None:
    """Edges of the left or right eye's lids; None where the head names no lids or sockets, or a lid has no edge."""
    needed = ("eye_socket", f"eyelid_upper_{side}", f"eyelid_lower_{side}")
    if any(name not in head.region_names for name in needed):
        return None
    socket, upper, lower = (head.region(name) > 0.5 for name in needed)
    return _edges(head, socket, upper, lower)


def lip_edges(head: HeadModel) -> OpeningEdges | None:
    """Edges of the lips; None where the head names no lips or lining, or cannot open its jaw."""
    if "lips" not in head.region_names or "mouth_inner" not in head.region_names:
        return None
    if "jawOpen" not in head.expression_names:
        return None
    drop = -head.expression[head.expression_names.index("jawOpen")][:, 1]
    lower, lips = drop > JAW_SHARE * float(drop.max()), head.region("lips") > 0.25
    return _edges(head, head.region("mouth_inner") > 0.5, lips & ~lower, lips & lower)


def _edges(head: HeadModel, inside: Bool, upper: Bool, lower: Bool) -> OpeningEdges | None:
    """From (V,) masks of the vertices inside the opening and on either edge; None where an edge has no row."""
    corners = head.skin_triangles
    found = OpeningEdges(_rows(corners, inside, upper), _rows(corners, inside, lower))
    return found if found.upper and found.lower else None


def _rows(corners: Int32, inside: Bool, allowed: Bool) -> tuple[Int64, ...]:
    """Up to ``ROWS`` rows of allowed vertices, each adjacent to the one before, the first adjacent to the inside.

    Corners are (T, 3) vertices of the skin's triangles; ``inside`` and ``allowed`` (V,) those in the opening and of
    this edge.
    """
    rows: list[Int64] = []
    taken = inside.copy()
    while len(rows) < ROWS:
        reached = np.unique(corners[taken[corners].any(1)])
        row = reached[allowed[reached] & ~taken[reached]].astype(np.int64)
        if not len(row):
            break
        rows.append(row)
        # All that was reached is taken, also beyond the corner, where it belongs to the other edge.
        taken[reached] = True
    return tuple(rows)


SIDES = ("left", "right")
IRIS_RADIUS_M, PUPIL_RADIUS_M = 0.00585, 0.0019
"""Of adults: the iris is 11.7 mm wide in nearly everybody; the pupil is that of a lit room."""

LEAST_RADIUS_M = 1e-4
"""Radius in metres from which a part of a head counts as an eyeball."""


@dataclass(frozen=True)
class Eyeball:
    """A sphere from the bounding box of an eye's vertices.

    Attributes:
        centre: (3,) float64 metres.
        radius: metres.
    """

    centre: Float64
    radius: float

    @classmethod
    def of(cls, vertices: AnyFloat) -> Eyeball:
        """From the (M, 3) vertices of one eye, M > 0, in metres."""
        low, high = (np.asarray(end, np.float64) for end in (vertices.min(0), vertices.max(0)))
        return cls((low + high) / 2, float((high - low).max()) / 2)

    @property
    def limbus_deg(self) -> float:
        """Degrees between the line of sight and the limbus, the iris's rim."""
        return self._angle(IRIS_RADIUS_M)

    @property
    def pupil_deg(self) -> float:
        """Degrees between the line of sight and the pupil's rim."""
        return self._angle(PUPIL_RADIUS_M)

    def _angle(self, radius_m: float) -> float:
        return float(np.degrees(np.arcsin(min(radius_m / max(self.radius, 1e-6), 0.9))))

    def rays(self, points: AnyFloat) -> Float64:
        """(N, 3) unit directions from the centre to points (N, 3); zero at the centre itself."""
        ray = np.asarray(points, np.float64) - self.centre
        return np.asarray(ray / np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), 1e-9))


def eyeball(head: HeadModel, vertices: AnyFloat, side: str) -> Eyeball | None:
    """The left or right eyeball of a head with vertices (V, 3) in metres; None where it has none."""
    name = f"eye_{side}"
    indices = part_vertices(head, name)
    if not len(indices):
        return None
    ball = Eyeball.of(np.asarray(vertices, np.float64)[indices])
    return ball if ball.radius > LEAST_RADIUS_M else None


def inter_ocular_m(head: HeadModel, vertices: AnyFloat) -> float:
    """Distance of the eyeball centres in metres; 63 mm, the mean of adults, for a head without two eyeballs."""
    centres = [np.asarray(vertices)[eye].mean(0) for side in SIDES if len(eye := part_vertices(head, f"eye_{side}"))]
    return float(np.linalg.norm(centres[0] - centres[1])) if len(centres) == 2 else 0.063


def pole(head: HeadModel, side: str) -> int:
    """The vertex in the middle of the left or right cornea, which looks ahead at rest."""
    eye = part_vertices(head, f"eye_{side}")
    return int(eye[np.argmax(head.mean[eye, 2])])
