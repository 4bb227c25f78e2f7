"""Light on parts beside the head's own: in the open without shadows; what wet surfaces mirror."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from service.arrays import AnyFloat, Float32
from service.geometry.normals import normalise
from service.light.environment import Illumination
from service.light.gloss import F0_SCALE
from service.light.graphs import Graphs, lamp_numbers
from service.light.harmonics import irradiance, project
from service.light.plan import Plan
from service.light.reflection import prefiltered
from service.light.scene import Triple
from service.materials.material import Material
from service.render.light import Visibility
from service.render.nodes import Nodes
from service.render.recess import Arriving
from service.render.view import Samples


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
