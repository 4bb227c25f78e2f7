"""Light in the recesses of the face: on eyes between their lids, and on teeth, gums and tongue between the lips.

These are meshes of their own, which are lit in the corners of a fine grid on what is seen of them: by the sky in the
directions that lids, brows, nose, lips and the meshes themselves leave open, and by each lamp so far as it is seen. In
the other directions stands flesh, which sends back what it receives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from service.archive.preview.quick import part_triangles
from service.arrays import AnyFloat, AnyInt, Bool, Float32, Int64
from service.geometry.normals import normalise
from service.geometry.sampling import surface_points, thinned
from service.head.model import HeadModel
from service.light.environment import Illumination, flux_by_direction, prefiltered, spread_directions
from service.light.formulas import F0_SCALE, Graphs, disc_of, lamp_numbers, mirror_weights
from service.light.harmonics import irradiance, project
from service.light.plan import Plan
from service.light.scene import Triple
from service.materials.material import Material
from service.materials.part import MeshPart
from service.render.view import Samples
from service.render.visibility import REACH_MM, Detail, Visibility, lamp_seen, sky_seen

NODES_M = 0.0008
"""Largest distance of the points at which light is computed, metres: a third of the height of a narrow eye's white."""
MOST_STEPS = 8
"""Most parts into which a triangle's side is divided for it."""


@dataclass(frozen=True)
class Nodes:
    """A grid on triangles, N points, and F places between them.

    Attributes:
        points: (N, 3) metres.
        normals: (N, 3) unit.
        corners: (F, 3) nodes around each place, and their ``weights`` (F, 3), sum 1.
    """

    points: Float32
    normals: Float32
    corners: Int64
    weights: Float32

    @classmethod
    def of(cls, points: AnyFloat, normals: AnyFloat, triangles: AnyInt, triangle: Int64, barycentric: Float32) -> Nodes:
        """Divide the triangles that hold places so that no side is longer than ``NODES_M``.

        Args:
            points: (V, 3) metres.
            normals: (V, 3).
            triangles: (T, 3).
            triangle: (F,) of each place.
            barycentric: (F, 3) of each place in it.
        """
        seen, which = np.unique(triangle, return_inverse=True)
        at = np.asarray(points, np.float64)[triangles[seen]]
        longest = float(np.linalg.norm(at - np.roll(at, 1, 1), axis=2).max(initial=0.0))
        steps = int(np.clip(np.ceil(longest / NODES_M), 1, MOST_STEPS))
        cell, inside = _lattice(barycentric, steps)
        keys, index = _numbered(triangles[seen][which], cell, steps)
        corner, share = keys[:, :3], keys[:, 3:] / np.float64(steps)
        place, normal = (np.einsum("nk,nkc->nc", share, np.asarray(v, np.float64)[corner]) for v in (points, normals))
        return cls(place.astype(np.float32), normalise(normal).astype(np.float32), index, inside)

    def read(self, values: Float32) -> Float32:
        """(F, C) of values (N, C)."""
        return np.asarray(np.einsum("fk,fkc->fc", self.weights, values[self.corners]), np.float32)


def _lattice(barycentric: Float32, steps: int) -> tuple[Int64, Float32]:
    """The three lattice points (F, 3, 3), in steps along each coordinate, around places, and their weights (F, 3)."""
    scaled = np.clip(np.asarray(barycentric, np.float64), 0, 1) * steps
    whole = np.minimum(np.floor(scaled), steps - 1).astype(np.int64)
    # A place on a corner or side is within the cell before it.
    over = np.maximum(whole.sum(1) - (steps - 1), 0)
    most = whole.argmax(1)
    whole[np.arange(len(whole)), most] -= over
    part = np.clip(scaled - whole, 0, 1)
    down = whole.sum(1) == steps - 2
    unit = np.eye(3, dtype=np.int64)[None]
    cell = whole[:, None, :] + np.where(down[:, None, None], 1 - unit, unit)
    weights = np.where(down[:, None], 1 - part, part)
    return cell, (weights / np.maximum(weights.sum(1, keepdims=True), 1e-9)).astype(np.float32)


def _numbered(corners: AnyInt, cell: Int64, steps: int) -> tuple[Int64, Int64]:
    """(N, 6) distinct lattice points, as three vertices and their steps, and (F, 3) which of them each is."""
    vertex = np.broadcast_to(corners[:, None, :], cell.shape).astype(np.int64)
    # A point on a side has the same key in both triangles: vertices that do not count are all the same.
    vertex = np.where(cell > 0, vertex, -1)
    order = np.argsort(vertex, axis=2, kind="stable")
    keys = np.concatenate([np.take_along_axis(a, order, 2) for a in (vertex, cell)], 2).reshape(-1, 6)
    distinct, index = np.unique(keys, axis=0, return_inverse=True)
    distinct[:, :3] = np.where(distinct[:, :3] < 0, distinct[:, 2:3], distinct[:, :3])
    return distinct, index.reshape(-1, 3)


MOUTH = frozenset({"teeth_upper", "teeth_lower", "teeth_upper_gums", "teeth_lower_gums", "tongue", "tongue_body"})
"""Names of the parts in the mouth."""

RECESSES = ("eyes", "mouth")

MOST_FLESH = 0.9
"""Largest albedo of what stands around; with 1 light would never leave a closed mouth."""
AROUND_M = 0.004
"""Width of the rim of skin around a recess whose light counts."""


def recess_of(name: str) -> str | None:
    """The recess that a part lies in, "eyes" or "mouth"; None for parts in the open."""
    if name in MOUTH:
        return "mouth"
    return "eyes" if name.startswith("eye_") else None


@dataclass(frozen=True)
class Arriving:
    """What reaches N points.

    Attributes:
        irradiance: (N, 3) of sky and lamps, past what stands around.
        openness: (N,) ambient occlusion in [0, 1], 1 = open.
        mirror: (N,) share in [0, 1] of the sky that is not hidden about the mirror direction.
        lamps: (N, L) visible share of each lamp in [0, 1].
    """

    irradiance: Float32
    openness: Float32
    mirror: Float32
    lamps: Float32

    def with_flesh(self, albedo: Float32, radiosity: Float32) -> tuple[Float32, Float32]:
        """(N, 3) irradiance with what flesh sends from where no sky is seen, and (N, 3) the radiosity of that flesh.

        Flesh near a point that sees little of the sky lies deep itself, and receives what the point does (Stewart and
        Langer 1997, eq. 12); near one that sees much it is the skin around the recess. Between them the share of the
        latter is the square root of the openness: the geometric mean of the point's and that of the open.

        Args:
            albedo: (3,) of the flesh.
            radiosity: (3,) of the skin around the recess.
        """
        hidden, outer = 1 - self.openness[:, None], np.sqrt(self.openness)[:, None]
        inner = np.minimum(albedo, MOST_FLESH) * (1 - outer)
        total = (self.irradiance + hidden * outer * radiosity) / (1 - hidden * inner)
        return np.asarray(total, np.float32), np.asarray(outer * radiosity + inner * total, np.float32)

    def at(self, nodes: Nodes, first: int) -> Arriving:
        """The same at the places of a grid whose nodes begin at the ``first`` point."""
        whole = np.concatenate([self.irradiance, self.openness[:, None], self.mirror[:, None], self.lamps], 1)
        found = nodes.read(whole[first : first + len(nodes.points)])
        return Arriving(found[:, :3], found[:, 3], found[:, 4], found[:, 5:])


@dataclass(frozen=True)
class Recess:
    """What stands around and in one recess.

    Attributes:
        occluders: (3, M) mm; ``spacing_mm`` of them.
        directions: into which the sky is divided.
    """

    occluders: Float32
    spacing_mm: float
    directions: int

    @classmethod
    def of(cls, parts: Sequence[MeshPart], head: HeadModel, vertices: AnyFloat, casts: Bool, detail: Detail) -> Recess:
        """A recess.

        Args:
            parts: those that lie in it.
            head: topology.
            vertices: (V, 3) metres.
            casts: (T,) triangles of the head that cast shadows.
            detail: the resolution.
        """
        millimetres = np.asarray(vertices, np.float64) * 1000.0
        near = np.zeros(len(millimetres), bool)
        clouds, spacing = [], detail.eyes_mm
        for part in parts:
            own = np.asarray(part.vertices, np.float64) * 1000.0
            near |= np.linalg.norm(millimetres - own.mean(0), axis=1) < REACH_MM
            if part.material.alpha == "opaque":
                clouds.append(surface_points(own, part_triangles(part.polygons), spacing))
        clouds.append(surface_points(millimetres, head.triangles[casts & near[head.triangles].any(1)], spacing))
        # Small triangles have more points than depth maps have cells.
        cloud = thinned(np.concatenate(clouds).astype(np.float64), spacing)
        return cls(np.ascontiguousarray(cloud.T, np.float32), spacing, detail.directions)

    def arriving(
        self, points: Float32, normals: Float32, viewpoint: Triple, light: Illumination, plan: Plan, graphs: Graphs
    ) -> Arriving:
        """What reaches points (N, 3), metres, with unit normals; ``plan`` says whether anything hides sky and lamps."""
        at = np.ascontiguousarray(np.concatenate([points * np.float32(1000), normals], 1).T)
        total, lamps = np.zeros((len(points), 3), np.float32), np.ones((len(points), len(light.lights)), np.float32)
        openness = mirror = np.ones(len(points), np.float32)
        if not light.dark and plan.runs("occlusion"):
            seen = sky_seen(graphs, self.directions, at, self.occluders, self.spacing_mm).T * np.float32(1 / 255)
            directions = spread_directions(self.directions).astype(np.float32)
            facing = seen * np.maximum(normals @ directions.T, 0)
            total = facing @ flux_by_direction(light.sky, self.directions).astype(np.float32)
            openness = np.clip(facing.sum(1) * np.float32(4 / self.directions), 0, 1)
            mirror = _mirrored(seen, points, normals, viewpoint, directions)
        elif not light.dark:
            total = irradiance(project(light.sky), normals).astype(np.float32)
        for i, lamp in enumerate(light.lights):
            if plan.runs("shadows", i):
                centre = (self.occluders.min(1) + self.occluders.max(1)).astype(np.float64) / 2000.0
                places = disc_of(lamp, centre) * 1000.0
                lamps[:, i] = lamp_seen(graphs, places, at, self.occluders, self.spacing_mm)
            given = {"position": at[:3], "normal": at[3:], "shade": np.ascontiguousarray(lamps[:, i])}
            total = total + graphs.at_points("irradiance", given, **lamp_numbers(lamp)).T
        return Arriving(np.asarray(total, np.float32), openness, mirror, lamps)


def _mirrored(seen: Float32, points: Float32, normals: Float32, viewpoint: Triple, directions: Float32) -> Float32:
    """(N,) share that is seen (N, D) of the directions about the mirror image of a viewpoint."""
    view = normalise(np.asarray(viewpoint, np.float64) - points)
    reflected = 2.0 * (normals * view).sum(1, keepdims=True) * normals - view
    weights = mirror_weights(normalise(reflected), np.zeros(len(view)), directions.astype(np.float64))
    return np.asarray((weights * seen).sum(1), np.float32)


def skin_around(parts: Sequence[MeshPart], positions: Float32, values: Float32) -> Float32:
    """(C,) mean of values of the skin that is seen within ``AROUND_M`` of parts; 0 where none is seen.

    Args:
        parts: in one recess.
        positions: (N, 3) metres, of the picture's samples.
        values: (N, C) of them.
    """
    near = np.zeros(len(positions), bool)
    for part in parts:
        low, high = part.vertices.min(0) - AROUND_M, part.vertices.max(0) + AROUND_M
        near |= ((positions > low) & (positions < high)).all(1)
    return np.asarray(values[near].mean(0) if near.any() else np.zeros(values.shape[1]), np.float32)


@dataclass(frozen=True)
class PartLight:
    """Light on parts.

    Attributes:
        light: of the scene; ``plan`` says which of its effects are computed.
        graphs: the formulas.
        visibility: of the head, whose casters and resolution are the recesses' too.
        viewpoint: (3,) metres.
        samples: of the picture on the head, their linear ``albedo`` and their ``radiance`` (N, 3).
    """

    light: Illumination
    plan: Plan
    graphs: Graphs
    visibility: Visibility
    viewpoint: Triple
    samples: Samples
    albedo: Float32
    radiance: Float32

    def on(self, points: Float32, normals: AnyFloat) -> Float32:
        """(N, 3) radiance of a white diffuse surface in the open at points (N, 3) in metres, unit normals (N, 3)."""
        arriving = np.zeros((3, len(points)), np.float32)
        if not self.light.dark:
            arriving += irradiance(project(self.light.sky), normals).T.astype(np.float32)
        at = {
            "position": np.ascontiguousarray(points.T * np.float32(1000)),
            "normal": np.ascontiguousarray(np.asarray(normals, np.float32).T),
            "shade": np.ones(len(points), np.float32),
        }
        for lamp in self.light.lights:
            arriving += self.graphs.at_points("irradiance", at, **lamp_numbers(lamp))
        return np.asarray(arriving.T / np.float32(np.pi), np.float32)

    @cached_property
    def levels(self) -> Float32 | None:
        """Reflections of the sky (``prefiltered``); None where they are left out."""
        mirrors = self.plan.runs("reflection") and not self.light.dark
        return prefiltered(self.light.sky) if mirrors else None

    def glossy(self, nodes: Nodes, there: Arriving, material: Material, flesh: Float32) -> tuple[Float32, Float32]:
        """(F, 3) radiance that a wet surface mirrors, and (F,) the share of light that it does not mirror.

        Where it mirrors no sky it mirrors flesh, whose radiosity is ``flesh`` (F, 3).

        F0 above 0.04, which only teeth have, counts as 0.04: the formulas know no more.
        """
        points, normals = nodes.read(nodes.points), normalise(nodes.read(nodes.normals)).astype(np.float32)
        offset = np.asarray(self.viewpoint, np.float32) - points
        count = len(points)
        common = {
            "view": np.ascontiguousarray(normalise(offset).T, np.float32), "normal": np.ascontiguousarray(normals.T),
            "specular": np.full(count, min(material.f0 / F0_SCALE, 1.0), np.float32),
            "alpha": np.full(count, material.roughness**2, np.float32),
        }  # fmt: skip
        part = self.graphs.at_points("kept", common)
        total = np.zeros((3, count), np.float32)
        if self.levels is not None:
            given = {key: common[key] for key in ("view", "normal", "alpha")} | {"part": part}
            open_sky = self.graphs.at_points("reflection", given | {"openness": np.ones_like(part)}, levels=self.levels)
            total += there.mirror * open_sky + (1 - there.mirror) * part * flesh.T / np.float32(np.pi)
        for i, lamp in enumerate(self.light.lights):
            if self.plan.runs("specular", i):
                position = np.ascontiguousarray(points.T * np.float32(1000))
                at = common | {"position": position, "shade": np.ascontiguousarray(there.lamps[:, i])}
                total += self.graphs.at_points("highlight", at, **lamp_numbers(lamp))
        return np.asarray(total.T, np.float32), np.asarray(1 - part, np.float32)
