"""Where hair grows and what it must not enter: roots on the scalp, and the distance to head and shoulders."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from service.arrays import AnyFloat, Bool, Float32, Float64, Int64
from service.geometry.mesh import folded, spread_points, unit, vertex_normals
from service.geometry.nearest import Nearest
from service.head.model import HeadModel

CENTRE = np.array([0.0, 0.02, -0.07], np.float32)
"""Middle of the skull, metres in the head's frame: azimuth and elevation of a root are seen from there."""
CROWN = np.array([0.012, 0.095, -0.125], np.float32)
"""The whorl, from which hair turns away; usually a little to the left of the middle (Wunderlich and Heerema 1975)."""
SHOULDERS = ((0.0, -0.27, -0.085), (0.215, 0.075, 0.085))
"""Middle and half axes, metres, of the ellipsoid that stands for the shoulders."""
SLIDES_BELOW = -0.165
"""Height, metres, below which hair is pushed level out of the body."""
CELL_M = 0.008
"""Side of a cell of the grid of distances."""
LOW, HIGH = (-0.30, -0.48, -0.34), (0.30, 0.26, 0.22)
"""Corners of that grid, metres."""
_LOW = np.array(LOW, np.float32)
_AT_ONCE = 1 << 14
"""Points that are read at a time, so that what is gathered for them fits into the cache."""
EVEN = 1200
"""Roots of :attr:`Scalp.even`: more than there are guides or large locks."""
EDGE = 0.45
"""Value of the head's soft mask of the scalp at the hairline."""
COARSE = 4
"""Points of the grid along each axis of which one is measured everywhere."""
NEAR_M = 0.03
"""Distance from the surface, by those alone, up to which all points are measured."""
DEEPEST_M = 0.11
"""No point in a head is farther from its skin; a rim that is seen from below has no inside."""
EAR_M = 0.0025
"""Radius of the balls that stand for the ears where hair that is grown and fitted lies over them."""
NEAR_EAR_M = 0.06
"""Half the side of a square with an ear."""
SPACING_M = 0.004
"""Distance between the points that stand for the skin when distances are measured."""


@dataclass(frozen=True)
class Roots:
    """Where strands begin.

    Attributes:
        position: (N, 3) float32 metres, on the skin.
        normal: (N, 3) float32 unit, outwards.
        edge: (N,) float32 in [0, 1]: 0 on the hairline, 1 well inside the scalp.
        uv: (N, 2) float32 in [0, 1], place on the head's chart, origin bottom left.
    """

    position: Float32
    normal: Float32
    edge: Float32
    uv: Float32

    def __len__(self) -> int:
        return len(self.position)

    def chosen(self, index: Int64 | Bool) -> Roots:
        """Those of an index or a mask."""
        return Roots(self.position[index], self.normal[index], self.edge[index], self.uv[index])

    @property
    def azimuth(self) -> Float32:
        """(N,) radians round the vertical, 0 in front, positive to the subject's left, pi behind."""
        away = self.position - CENTRE
        return np.asarray(np.arctan2(away[:, 0], away[:, 2]), np.float32)

    @property
    def elevation(self) -> Float32:
        """(N,) radians above the middle of the skull."""
        away = self.position - CENTRE
        return np.asarray(np.arcsin(away[:, 1] / np.maximum(np.linalg.norm(away, axis=1), 1e-6)), np.float32)


@dataclass(frozen=True)
class Field:
    """Values on the grid of ``CELL_M`` from ``LOW``, trilinear between its points; beyond it those of its border.

    Attributes:
        values: (X, Y, Z) float32.
    """

    values: Float32

    def read(self, points: Float32) -> Float32:
        """(...) float32 at points (..., 3) metres."""
        return self._at(self.values.reshape(-1, 1), points)[..., 0]

    def slope(self, points: Float32) -> Float32:
        """(..., 3) float32 at points (..., 3) metres: the change over two cells, one before and one behind."""
        return self._at(self._slopes, points)

    @cached_property
    def _slopes(self) -> Float32:
        rows = np.pad(self.values, 1, mode="edge")
        slopes = [
            rows[2:, 1:-1, 1:-1] - rows[:-2, 1:-1, 1:-1], rows[1:-1, 2:, 1:-1] - rows[1:-1, :-2, 1:-1],
            rows[1:-1, 1:-1, 2:] - rows[1:-1, 1:-1, :-2],
        ]  # fmt: skip
        return np.stack(slopes, -1).reshape(-1, 3)

    def _at(self, rows: Float32, points: Float32) -> Float32:
        """(..., C) of rows (X * Y * Z, C)."""
        flat, shape = points.reshape(-1, 3), self.values.shape
        step = (shape[1] * shape[2], shape[2], 1)
        corners = np.array([np.dot(one, step) for one in np.ndindex(2, 2, 2)])[:, None]
        alone = rows.shape[1] == 1
        values = rows.ravel() if alone else rows
        made = np.zeros((len(flat), rows.shape[1]), np.float32)
        for first in range(0, len(flat), _AT_ONCE):
            place = (flat[first : first + _AT_ONCE] - _LOW) * np.float32(1 / CELL_M)
            index, parts = np.zeros(len(place), np.int64), []
            for along, side in enumerate(shape):
                own = np.minimum(np.maximum(place[:, along], 0), np.float32(side - 1))
                low = np.minimum(own.astype(np.int64), side - 2)
                parts.append(own - low.astype(np.float32))
                index += low * step[along]
            x, y, z = parts if alone else (part[:, None] for part in parts)
            found = values.take(index + corners, 0, mode="clip")  # all lie within: a quarter faster than "raise"
            found = found[:4] + x * (found[4:] - found[:4])
            found = found[:2] + y * (found[2:] - found[:2])
            found = found[0] + z * (found[1] - found[0])
            made[first : first + _AT_ONCE] = found[:, None] if alone else found
        return made.reshape(*points.shape[:-1], rows.shape[1])


@dataclass(frozen=True)
class Scalp:
    """The skin on which hair grows, and the distance to the body.

    Attributes:
        corners: (T, 3, 3) float32 metres of the triangles of the scalp.
        normals: (T, 3, 3) float32 unit, at their corners.
        grows: (T, 3) float32 in [0, 1] at their corners: 1 on the scalp, 0 on bare skin.
        uv: (T, 3, 2) float32 in [0, 1], of the corners on the head's chart.
        distance: metres from head and shoulders, negative inside.
        ears: (E, 3) float32 metres, vertices of the ears.
    """

    corners: Float32
    normals: Float32
    grows: Float32
    uv: Float32
    distance: Field
    ears: Float32

    @classmethod
    def of(cls, head: HeadModel, vertices: AnyFloat | None = None) -> Scalp:
        """The scalp of a head.

        Args:
            head: the model; its region ``scalp`` says where hair grows.
            vertices: (V, 3) metres; None for the mean head.
        """
        points = np.asarray(head.mean if vertices is None else vertices, np.float32)
        normal = vertex_normals(points, head.triangles).astype(np.float32)
        of_skin = head.triangle_part == head.part_names.index("skin")
        skin = head.triangles[of_skin]
        mask = head.region("scalp")
        grows = (mask[skin] > 0.02).any(1)
        own, uv = skin[grows], head.uv[head.triangle_uv[of_skin][grows]]
        hidden = np.maximum(head.region("mouth_inner"), head.region("eye_socket"))
        outer = skin[(hidden[skin] < 0.5).all(1)]
        ears = points[np.maximum(head.region("ear_left"), head.region("ear_right")) > 0.5]
        return cls(points[own], normal[own], mask[own].astype(np.float32), uv, Field(_distances(points[outer])), ears)

    def roots(self, count: int, rng: np.random.Generator, least: float = EDGE) -> Roots:
        """``count`` roots where hair grows, in random order: more where the mask is surer, none below ``least`` of it.

        Raises:
            ValueError: hair grows nowhere.
        """
        if not (self.grows > least).any():
            raise ValueError(f"hair grows nowhere: the scalp's mask is at most {self.grows.max(initial=0):.2f}")
        chance = self.area * self.grows.mean(1)
        drawn, made = count, self._spread(count, chance, rng, least)
        while len(made) < count:  # some fall on bare skin
            drawn = int(drawn * min(1.02 * count / max(len(made), 1), 4.0)) + 8
            made = self._spread(drawn, chance, rng, least)
        return made.chosen(rng.permutation(len(made))[:count])

    def _spread(self, count: int, chance: Float32, rng: np.random.Generator, least: float) -> Roots:
        """Roots of ``count`` places that are spread evenly, by chance of the triangles, less those on bare skin."""
        # As many in each triangle as it is due, and there by a low-discrepancy sequence: no clumps, no gaps.
        due = np.cumsum(chance / chance.sum()) * count
        triangle = np.minimum(np.searchsorted(due, np.arange(count) + rng.random()), len(due) - 1)
        weight = folded(np.arange(count) + rng.integers(1 << 20)).astype(np.float32)[..., None]
        grows = (self.grows[triangle] * weight[..., 0]).sum(1)
        kept = np.flatnonzero(grows > least)
        own, weight = triangle[kept], weight[kept]
        position, normal = ((values[own] * weight).sum(1) for values in (self.corners, self.normals))
        edge = np.clip((grows[kept] - least) / max(1.0 - least, 1e-3), 0, 1)
        uv = (self.uv[own] * weight).sum(1)
        return Roots(position, unit(normal), edge.astype(np.float32), uv.astype(np.float32))

    @cached_property
    def area(self) -> Float32:
        """(T,) float32 square metres of the triangles."""
        edges = self.corners[:, 1:] - self.corners[:, :1]
        return np.asarray(0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1), np.float32)

    @cached_property
    def even(self) -> Roots:
        """``EVEN`` roots in such an order that the first of them, however many, are spread evenly.

        The farthest comes first (Gonzalez 1985).
        """
        roots = self.roots(4 * EVEN, np.random.default_rng(0xE7E), least=EDGE)
        chosen = np.zeros(EVEN, np.int64)
        apart = np.full(len(roots), np.inf, np.float32)
        x, y, z = np.ascontiguousarray(roots.position.T)
        for i in range(1, EVEN):
            last = chosen[i - 1]
            apart = np.minimum(apart, (x - x[last]) ** 2 + (y - y[last]) ** 2 + (z - z[last]) ** 2)
            chosen[i] = int(apart.argmax())
        return roots.chosen(chosen)

    @cached_property
    def over_ears(self) -> Scalp:
        """The same with a ball round each vertex of the ears: thinner than a cell, their tips came through hair."""
        cells = _cells().reshape(-1, 3)
        beside = np.flatnonzero((np.abs(cells[:, 1:] - self.ears[:, 1:].mean(0)) < NEAR_EAR_M).all(1))
        apart = Nearest(self.ears).one(cells[beside])[0]
        distance = self.distance.values.copy()
        distance.flat[beside] = np.minimum(distance.flat[beside], apart - EAR_M)
        return replace(self, distance=Field(distance))

    def outside(self, points: Float32) -> Float32:
        """(...) float32 metres from points (..., 3) to the body, negative inside; beyond the grid its border's."""
        return self.distance.read(points)

    def pushed(self, points: Float32, clearance: Float32 | float, most: float = 1.0) -> Float32:
        """Points (..., 3) moved out of the body until they are ``clearance`` metres from it, by at most ``most``."""
        moved = np.array(points, np.float32)
        wanted = np.broadcast_to(np.asarray(clearance, np.float32), moved.shape[:-1])
        for _ in range(2):
            away = wanted - self.outside(moved)
            near = away > 0
            if not near.any():
                break
            moved[near] += np.minimum(away[near], most)[:, None] * self.outwards(moved[near])
        return moved

    def outwards(self, points: Float32) -> Float32:
        """(..., 3) float32 unit vectors along which the distance to the body grows fastest."""
        found = self.distance.slope(points)
        # Hair slides off the shoulders, to the front or to the back; it does not lie on them like straw.
        low = points[..., 1] < SLIDES_BELOW
        found[..., 1] = np.where(low, 0.0, found[..., 1])
        ahead = np.where(points[..., 2] < SHOULDERS[0][2] + 0.02, -1.0, 1.0)
        found[..., 2] = np.where(low, found[..., 2] + 0.5 * CELL_M * ahead, found[..., 2])
        return unit(found)


@lru_cache(maxsize=1)
def mean_scalp() -> Scalp:
    """The scalp of the mean head in the box."""
    from service.head.files import load_head

    return Scalp.of(load_head())


def length_of(lines: Float32) -> Float32:
    """(N,) lengths of lines through points (N, P, 3)."""
    return np.asarray(_steps(lines).sum(1), np.float32)


def _steps(lines: Float32) -> Float32:
    """(N, P - 1) lengths between points (N, P, 3)."""
    x, y, z = (part[:, 1:] - part[:, :-1] for part in np.moveaxis(lines, 2, 0))
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def gone_along(lines: Float32) -> Float64:
    """(N, P) length of lines through points (N, P, 3) up to each of these."""
    return np.concatenate([np.zeros((len(lines), 1)), np.cumsum(_steps(lines), 1)], 1)


def _distances(triangles: Float32) -> Float32:
    """Signed distances on the grid to triangles (T, 3, 3), whose fronts look outwards, and to the shoulders."""
    samples, normals = _dense(triangles)
    nearest, cells = Nearest(samples), _cells()

    def signed(points: Float32) -> Float32:
        """(N,) at points (N, 3). The nearest sample's plane flips sign beside folds such as the ear's; four vote."""
        apart, four = nearest(points, 4)
        along = ((points[:, None] - samples[four]) * normals[four]).sum(-1).mean(1)
        return np.where((along < 0) & (apart[:, 0] < DEEPEST_M), -apart[:, 0], apart[:, 0])

    # Far from the surface distances are as good as linear: there, every fourth point along each axis tells them.
    some = cells[::COARSE, ::COARSE, ::COARSE]
    away = signed(some.reshape(-1, 3)).reshape(some.shape[:3])
    for axis, (fine, coarse) in enumerate(zip(cells.shape, some.shape[:3], strict=False)):
        place = np.minimum(np.arange(fine) / COARSE, coarse - 1)
        hats = 1 - np.abs(place[:, None] - np.arange(coarse))
        away = np.moveaxis(np.tensordot(np.maximum(hats, 0).astype(np.float32), away, (1, axis)), 0, axis)
    near = np.abs(away) < NEAR_M
    away[near] = signed(cells[near])
    # The neck is open below; what lies under its rim belongs to the shoulders.
    rim = triangles[..., 1].min()
    below = cells[..., 1] < rim
    away = np.where(below, np.abs(away), away)
    middle, radii = (np.array(values, np.float32) for values in SHOULDERS)
    scaled = np.linalg.norm((cells - middle) / radii, axis=-1)
    shoulders = (scaled - 1.0) * radii.min()
    return np.asarray(np.minimum(away, shoulders), np.float32)


def _cells() -> Float32:
    """(X, Y, Z, 3) metres, the points of the grid."""
    axes = [np.arange(low, high, CELL_M, dtype=np.float32) for low, high in zip(LOW, HIGH, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1)


def _dense(triangles: Float32) -> tuple[Float32, Float32]:
    """Points on triangles, about ``SPACING_M`` apart, and the unit normals there."""
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(across, axis=1)
    triangles, across, area = triangles[area > 1e-12], across[area > 1e-12], area[area > 1e-12]
    index, weight, _ = spread_points(area / 2, SPACING_M**2)
    points = (triangles[index] * weight.astype(np.float32)[..., None]).sum(1)
    return points.astype(np.float32), unit(across[index] / area[index, None])
