"""Light on the parts beside the head's skin: in the open, and in the recesses of the face.

Eyes between their lids, and teeth, gums and tongue between the lips, are lit by the sky in the directions that lids,
brows, nose, lips and they themselves leave open, and by each lamp so far as it is seen. In the other directions stands
flesh, which sends back what it receives. They mirror what is left. Hair is lit as strands (``service.render.strands``).
The bust has what head and hair leave of the light, as the neck above it has. Lashes have the light of the open.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from service.arrays import Bool, Float32, Int64
from service.geometry.mesh import normalise
from service.geometry.nearest import Nearest
from service.geometry.sampling import surface_points, thinned
from service.light.environment import Illumination, flux_by_direction, prefiltered, spread_directions
from service.light.formulas import F0_SCALE, Graphs, irradiance, lamp_numbers, mirror_weights, project, with_flesh
from service.light.plan import LightPlan
from service.light.scene import Triple
from service.materials.material import Material
from service.materials.part import MeshPart, part_triangles
from service.render.draw import HIDDEN, SeenHead, SeenPart
from service.render.drawn import RECESSES, DrawnHead, recess_of
from service.render.sketch import open_light
from service.render.strands import BIAS, HairVolume, StrandLight
from service.render.visibility import Occluders, VisibilityDetail

GRAIN_M = 0.0006
"""Distance of the points at which light is computed, metres: a quarter of the height of a narrow eye's white."""
NEIGHBOURS = 6
"""Points between which light is interpolated."""

REACH_MM = 30.0
"""Distance from the box around a part up to which geometry casts shadows on it: brows, lips and cheeks lie within."""
CLEAR_M = 0.004
"""Height over parts in the open at which light is computed: they meet the head, whose points are a cell wide."""
AROUND_M = 0.004
"""Width of the rim of skin around a recess whose light counts."""


@dataclass(frozen=True)
class Nodes:
    """Few of many points, between which what varies slowly is interpolated.

    Attributes:
        index: (N,) of the nodes among the points.
        near: (F, K) nodes around each of the F points, and their ``weights`` (F, K), sum 1.
    """

    index: Int64
    near: Int64
    weights: Float32

    @classmethod
    def of(cls, points: Float32) -> Nodes:
        """One node per cube of side ``GRAIN_M`` of points (F, 3), metres, F > 0."""
        cell = np.floor((points - points.min(0)) / GRAIN_M).astype(np.int64).clip(max=(1 << 21) - 1)
        _, index = np.unique(cell @ np.array([1 << 42, 1 << 21, 1]), return_index=True)
        away, near = Nearest(points[index])(points, NEIGHBOURS)
        share = np.exp(-((away - away[:, :1]) * (away + away[:, :1])) / GRAIN_M**2)
        return cls(index, near, np.asarray(share / share.sum(1, keepdims=True), np.float32))

    def read(self, values: Float32) -> Float32:
        """(F, C) of values (N, C)."""
        return np.asarray(np.einsum("fk,fkc->fc", self.weights, values[self.near]), np.float32)


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

    def part(self, rows: slice) -> Arriving:
        """What reaches some of the points."""
        return Arriving(self.irradiance[rows], self.openness[rows], self.mirror[rows], self.lamps[rows])

    def between(self, read: Callable[[Float32], Float32]) -> Arriving:
        """The same at F points, whose values ``read`` interpolates: (F, C) of (N, C)."""
        whole = np.concatenate([self.irradiance, self.openness[:, None], self.mirror[:, None], self.lamps], 1)
        found = read(whole)
        return Arriving(found[:, :3], found[:, 3], found[:, 4], found[:, 5:])


def surroundings(parts: Sequence[MeshPart], model: DrawnHead, spacing_mm: float, graphs: Graphs) -> Occluders:
    """What stands around and in the recess of a head that some parts lie in, as points ``spacing_mm`` apart."""
    millimetres = np.asarray(model.vertices, np.float64) * 1000.0
    near, clouds = np.zeros(len(millimetres), bool), []
    for part in parts:
        own = np.asarray(part.vertices, np.float64) * 1000.0
        beyond = np.maximum(own.min(0) - millimetres, millimetres - own.max(0))
        near |= np.linalg.norm(np.maximum(beyond, 0), axis=1) < REACH_MM
        if part.material.alpha == "opaque":
            clouds.append(surface_points(own, part_triangles(part.polygons), spacing_mm))
    clouds.append(surface_points(millimetres, model.head.triangles[near[model.head.triangles].any(1)], spacing_mm))
    # Small triangles have more points than depth maps have cells.
    cloud = thinned(np.concatenate(clouds).astype(np.float64), spacing_mm)
    return Occluders(np.ascontiguousarray(cloud.T, np.float32), spacing_mm, graphs)


@dataclass(frozen=True)
class RecessLight:
    """Light on parts.

    Attributes:
        light: of the scene; ``plan`` says which of its effects are computed.
        graphs: the formulas.
        detail: resolution of the visibility.
        viewpoint: (3,) metres.
        hair: what stops light; None on a head without.
    """

    light: Illumination
    plan: LightPlan
    graphs: Graphs
    detail: VisibilityDetail
    viewpoint: Triple
    hair: HairVolume | None = None

    def light_parts(self, seen: SeenHead, skin: Float32, whole: tuple[Occluders, Occluders]) -> None:
        """Set the radiance of all fragments.

        ``skin`` (N, 6) is albedo and radiosity of the points on the head; ``whole`` the head and what is opaque beside
        it, as casters of sharp shadows and of soft ones.
        """
        recesses: dict[str, list[tuple[SeenPart, Bool]]] = {name: [] for name in RECESSES}
        eye = np.array(self.viewpoint, np.float32)
        strands = None if self.hair is None else StrandLight(self.light, self.graphs, self.hair, eye)
        for one, reached in zip(seen.parts, seen.reached() if seen.parts else (), strict=True):
            where, visible = recess_of(one.part.name), reached > HIDDEN
            if where is None and one.along is not None and strands is not None:
                strands.lit(one, one.along, strands.shares(one.part), visible)
            elif where is None and one.part.material.alpha == "opaque":
                self._light_outside(one, visible, whole, skin_around([one.part], seen.position_m, skin))
            elif where is None:
                lit = open_light(self.light, self.graphs, one.part.vertices, one.drawn.normals)
                one.radiance = one.colour * one.between(lit)
            elif visible.any():
                recesses[where].append((one, visible))
        for name, inside in recesses.items():
            if inside:
                own = [one.part for one in seen.model.parts if recess_of(one.part.name) == name]
                around = surroundings(own, seen.model, self.detail.recess_mm, self.graphs)
                self._light_recess(inside, around, skin_around(own, seen.position_m, skin))

    def _light_outside(self, one: SeenPart, visible: Bool, whole: tuple[Occluders, Occluders], skin: Float32) -> None:
        """Light a part in the open: by the sky at its vertices, by lamps, whose shadows are sharp, at each fragment.

        ``visible`` (F,) are its fragments that are seen; ``skin`` (6,) is albedo and radiosity of that around.
        """
        own = np.concatenate([one.part.vertices, one.drawn.normals], 1).astype(np.float32)
        place, facing = np.split(own, 2, 1)
        hair = None if self.hair is None else self.hair.alone
        sky = self.from_sky(place + np.float32(CLEAR_M) * facing, facing, whole[1], hair)
        point, facing = np.split(one.between(own)[visible], 2, 1)
        normal = normalise(facing).astype(np.float32)
        there = sky.between(lambda values: one.between(values)[visible])
        there = self.with_lamps(there, point + np.float32(CLEAR_M) * normal, normal, whole[0], hair)
        self._shine(one, visible, point, normal, there, skin)

    def _light_recess(self, inside: Sequence[tuple[SeenPart, Bool]], around: Occluders, skin: Float32) -> None:
        places = []
        for one, visible in inside:
            at = np.concatenate([one.part.vertices, one.drawn.normals], 1).astype(np.float32)
            point, normal = np.split(one.between(at)[visible], 2, 1)
            normal = normal if one.normals is None else one.normals[visible]
            places.append((point, normalise(normal).astype(np.float32), Nodes.of(point)))
        points = np.concatenate([point[nodes.index] for point, _, nodes in places])
        normals = np.concatenate([normal[nodes.index] for _, normal, nodes in places])
        whole = self.arriving(points, normals, around)
        parts = _parts([len(nodes.index) for _, _, nodes in places])
        for (one, visible), (point, normal, nodes), part in zip(inside, places, parts, strict=True):
            self._shine(one, visible, point, normal, whole.part(part).between(nodes.read), skin)

    def _shine(
        self, one: SeenPart, visible: Bool, point: Float32, normal: Float32, there: Arriving, skin: Float32
    ) -> None:
        """Set the radiance of the visible fragments, F of them, at points (F, 3) with unit normals; ``skin`` (6,) is
        albedo and radiosity of that around.
        """
        arriving, flesh = (one.T for one in with_flesh(there.irradiance.T, there.openness, *skin.reshape(2, 3, 1)))
        mirrored, kept = self._glossy(point, normal, there, one.part.material, flesh)
        one.radiance[visible] = one.colour[visible] * arriving / np.float32(np.pi) * kept[:, None] + mirrored

    def arriving(self, points: Float32, normals: Float32, around: Occluders) -> Arriving:
        """What reaches points (N, 3), metres, with unit normals; the plan says whether anything hides sky and lamps."""
        return self.with_lamps(self.from_sky(points, normals, around), points, normals, around)

    def from_sky(
        self, points: Float32, normals: Float32, around: Occluders, hair: HairVolume | None = None
    ) -> Arriving:
        """As :meth:`arriving`, of the sky alone; ``hair`` stands before it, too."""
        light, count = self.light, self.detail.directions
        total, lamps = np.zeros((len(points), 3), np.float32), np.ones((len(points), 0), np.float32)
        openness = mirror = np.ones(len(points), np.float32)
        if not light.dark and self.plan.runs("occlusion"):
            seen = around.sky(count, _at(points, normals)).T * np.float32(1 / 255)
            if hair is not None:
                seen *= hair.from_sky(points * np.float32(1000), count, BIAS["skin"]).T
            directions = spread_directions(count).astype(np.float32)
            facing = seen * np.maximum(normals @ directions.T, 0)
            total = facing @ flux_by_direction(light.sky, count).astype(np.float32)
            openness = np.clip(facing.sum(1) * np.float32(4 / count), 0, 1)
            view = normalise(np.asarray(self.viewpoint, np.float64) - points)
            reflected = normalise(2.0 * (normals * view).sum(1, keepdims=True) * normals - view)
            weights = mirror_weights(reflected, np.zeros(len(view)), directions.astype(np.float64))
            mirror = np.asarray((weights * seen).sum(1), np.float32)
        elif not light.dark:
            total = irradiance(project(light.sky), normals).astype(np.float32)
        return Arriving(total, openness, mirror, lamps)

    def with_lamps(
        self, sky: Arriving, points: Float32, normals: Float32, around: Occluders, hair: HairVolume | None = None
    ) -> Arriving:
        """The same points with the light of the lamps."""
        at, total = _at(points, normals), sky.irradiance
        lamps = np.ones((len(points), len(self.light.lights)), np.float32)
        for i, lamp in enumerate(self.light.lights):
            if self.plan.runs("shadows", i):
                lamps[:, i] = around.lamp(around.places(lamp), at)
                if hair is not None:
                    lamps[:, i] *= hair.from_lamp(points * np.float32(1000), lamp, BIAS["skin"])
            given = {"position": at[:3], "normal": at[3:], "shade": np.ascontiguousarray(lamps[:, i])}
            total = total + self.graphs.at_points("irradiance", given, **lamp_numbers(lamp)).T
        return replace(sky, irradiance=np.asarray(total, np.float32), lamps=lamps)

    @cached_property
    def _levels(self) -> Float32 | None:
        """Reflections of the sky (``prefiltered``); None where they are left out."""
        mirrors = self.plan.runs("reflection") and not self.light.dark
        return prefiltered(self.light.sky) if mirrors else None

    def _glossy(
        self, points: Float32, normals: Float32, there: Arriving, material: Material, flesh: Float32
    ) -> tuple[Float32, Float32]:
        """(F, 3) radiance that a wet surface mirrors, and (F,) the share of light that it does not mirror.

        Where it mirrors no sky it mirrors flesh, whose radiosity is ``flesh`` (F, 3).

        F0 above 0.04, which teeth and tears have, scales what the formulas give for 0.04: they know no more.
        """
        count = len(points)
        common = {
            "view": np.ascontiguousarray(normalise(np.asarray(self.viewpoint, np.float32) - points).T, np.float32),
            "normal": np.ascontiguousarray(normals.T),
            "specular": np.full(count, min(material.f0 / F0_SCALE, 1.0), np.float32),
            "alpha": np.full(count, material.roughness**2, np.float32),
        }
        part = self.graphs.at_points("kept", common)
        total = np.zeros((3, count), np.float32)
        if self._levels is not None:
            given = {key: common[key] for key in ("view", "normal", "alpha")} | {"part": part}
            open_sky = self.graphs.at_points(
                "reflection", given | {"openness": np.ones_like(part)}, levels=self._levels
            )
            total += there.mirror * open_sky + (1 - there.mirror) * part * flesh.T / np.float32(np.pi)
        for i, lamp in enumerate(self.light.lights):
            if self.plan.runs("specular", i):
                position = np.ascontiguousarray(points.T * np.float32(1000))
                at = common | {"position": position, "shade": np.ascontiguousarray(there.lamps[:, i])}
                total += self.graphs.at_points("highlight", at, **lamp_numbers(lamp))
        total, part = (max(material.f0 / F0_SCALE, 1.0) * one for one in (total, part))
        return np.asarray(total.T, np.float32), np.asarray(1 - np.minimum(part, 1), np.float32)


def _parts(counts: Sequence[int]) -> list[slice]:
    """Rows of each of several groups that lie one after the other."""
    ends = np.cumsum(counts)
    return [slice(int(end) - count, int(end)) for end, count in zip(ends, counts, strict=True)]


def _at(points: Float32, normals: Float32) -> Float32:
    """(6, N) position in mm and unit normal of points (N, 3), metres."""
    return np.ascontiguousarray(np.concatenate([points * np.float32(1000), normals], 1).T)


def skin_around(parts: Sequence[MeshPart], positions: Float32, values: Float32) -> Float32:
    """(C,) mean of values (N, C) of the skin that is seen, at positions (N, 3) metres, within ``AROUND_M`` of the parts
    in one recess; 0 where none is seen.
    """
    near = np.zeros(len(positions), bool)
    for part in parts:
        low, high = part.vertices.min(0) - AROUND_M, part.vertices.max(0) + AROUND_M
        near |= ((positions > low) & (positions < high)).all(1)
    return np.asarray(values[near].mean(0) if near.any() else np.zeros(values.shape[1]), np.float32)
