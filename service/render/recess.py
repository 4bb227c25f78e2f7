"""Light in the recesses of the face: on eyes between their lids, and on teeth, gums and tongue between the lips.

These are meshes of their own, which are lit in the corners of a fine grid on what is seen of them: by the sky in the
directions that lids, brows, nose, lips and the meshes themselves leave open, and by each lamp so far as it is seen. In
the other directions stands flesh, which sends back what it receives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.archive.preview.parts import part_triangles
from service.arrays import AnyFloat, Bool, Float32
from service.geometry.normals import normalise
from service.geometry.points import surface_points, thinned
from service.head.model import HeadModel
from service.light.environment import Illumination
from service.light.gloss import mirror_weights
from service.light.graphs import Graphs, lamp_numbers
from service.light.harmonics import irradiance, project
from service.light.lamps import disc_of
from service.light.plan import Plan
from service.light.scene import Triple
from service.light.sphere import flux_by_direction, spread_directions
from service.materials.part import MeshPart
from service.render.eyes import REACH_MM
from service.render.light import Detail
from service.render.nodes import Nodes
from service.render.occlusion import lamp_seen, sky_seen

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
