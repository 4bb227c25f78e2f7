"""Visibility of sky and lamps from the surface of a head: depth maps, ambient occlusion and cast shadows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from service.arrays import AnyFloat, Float32, Float64, UInt8
from service.geometry.chart import Chart
from service.geometry.sampling import surface_points
from service.head.model import HeadModel
from service.light.environment import flux_by_direction, spread_directions
from service.light.formulas import Graphs, disc_of
from service.light.scene import PointLight
from service.materials.part import MeshPart, part_triangles
from service.render.strands import BIAS, HairVolume

Size = tuple[int, int]


@dataclass(frozen=True)
class VisibilityDetail:
    """Resolution of the visibility.

    Attributes:
        directions: into which the sky is divided.
        sky_size: (width, height) of the chart on which the sky's visibility is computed.
        shadow_size: the same for lamps.
        casters_mm: spacing of the points that cast hard shadows, and of those that cast soft ones and hide the sky.
        recess_mm: spacing of the points that shade eyes and teeth.
        narrowest: width of the smallest chart that is lit, a multiple of 3.
    """

    directions: int = 256
    sky_size: Size = (192, 128)
    shadow_size: Size = (768, 512)
    casters_mm: tuple[float, float] = (0.9, 1.8)
    recess_mm: float = 0.45
    narrowest: int = 384


@dataclass(frozen=True)
class Occluders:
    """What stands around points and hides light from them.

    Attributes:
        points: (3, M) mm, on all surfaces, ``spacing_mm`` apart.
        graphs: the formulas.
    """

    points: Float32
    spacing_mm: float
    graphs: Graphs

    def sky(self, count: int, at: Float32) -> UInt8:
        """(count, N) visibility of ``spread_directions``, 255 = fully visible; 0 below the horizon.

        Points ``at`` are (6, N): position in mm and unit normal.
        """
        seen = np.zeros((count, at.shape[1]), np.uint8)
        for k, direction in enumerate(spread_directions(count)):
            if (direction @ at[3:] > 0).any():
                towards = direction.astype(np.float32)
                lit = self.graphs.lit("lit_from_direction", self.points, self.spacing_mm, at, towards)
                seen[k] = np.rint(lit * 255.0)
        return seen

    def lamp(self, places: AnyFloat, at: Float32) -> Float32:
        """(N,) mean share in [0, 1] of the light from places (K, 3) mm that arrives ``at`` points, see :meth:`sky`."""
        total = np.zeros(at.shape[1], np.float32)
        for place in places:
            total += self.graphs.lit("lit_from_point", self.points, self.spacing_mm, at, place.astype(np.float32))
        return total / np.float32(len(places))

    def places(self, light: PointLight) -> Float64:
        """(K, 3) mm, points on a lamp's disc, which faces the middle of the occluders as in the light stage."""
        return disc_of(light, (self.points.min(1).astype(np.float64) + self.points.max(1)) / 2000.0) * 1000.0


@dataclass(frozen=True)
class Visibility:
    """Light that reaches the texels of a head; each result is computed on first use.

    Attributes:
        head: the skin, with its chart; all of it casts shadows.
        vertices: (V, 3) metres.
        graphs: the formulas.
        detail: the resolution.
        hair: shades the head; None on one without.
        beside: opaque parts in the open, which cast shadows as the head does: its bust.
    """

    head: HeadModel
    vertices: AnyFloat
    graphs: Graphs
    detail: VisibilityDetail = VisibilityDetail()
    hair: HairVolume | None = None
    beside: tuple[MeshPart, ...] = ()

    @cached_property
    def casters(self) -> tuple[Occluders, Occluders]:
        """What casts hard shadows, and what casts soft ones and hides the sky."""
        meshes = [(self.vertices, self.head.triangles)]
        meshes += [(part.vertices, part_triangles(part.polygons)) for part in self.beside]

        def cloud(spacing_mm: float) -> Occluders:
            points = [surface_points(np.asarray(at) * 1000.0, triangles, spacing_mm) for at, triangles in meshes]
            return Occluders(np.ascontiguousarray(np.concatenate(points).T), spacing_mm, self.graphs)

        hard, soft = self.detail.casters_mm
        return cloud(hard), cloud(soft)

    @cached_property
    def _lamp_points(self) -> tuple[Chart, Float32]:
        """The chart on which shadows of lamps are computed, and its (6, N) points."""
        chart = Chart.build(self.head, *self.detail.shadow_size)
        return chart, _points(chart, self.vertices)

    @cached_property
    def sky(self) -> UInt8:
        """(D, h, w) visibility of each direction, 255 = fully visible; takes about 2 s."""
        chart = Chart.build(self.head, *self.detail.sky_size)
        at = _points(chart, self.vertices)
        seen = self.casters[1].sky(self.detail.directions, at)
        if self.hair is not None:
            through = self.hair.from_sky(at[:3].T, self.detail.directions, BIAS["skin"])
            seen = np.rint(seen * through).astype(np.uint8)
        spread = chart.fill_outside(chart.spread(seen.T.astype(np.float32)))
        return np.ascontiguousarray(np.moveaxis(spread, 2, 0).astype(np.uint8))

    def sky_light(self, sky: AnyFloat, size: Size) -> Float32:
        """(H, W, 3 colours, 3 axes) vector irradiance, sum of V d flux; its dot product with a normal is irradiance."""
        count = self.detail.directions
        flux, directions = flux_by_direction(sky, count), spread_directions(count)
        each = (flux[:, :, None] * directions[:, None, :]).reshape(count, 9)
        return self._summed(each, size).reshape(size[1], size[0], 3, 3)

    def openness(self, normal: Float32) -> Float32:
        """(H, W) ambient occlusion in [0, 1], 1 = open, for smooth normals (H, W, 3)."""
        each = spread_directions(self.detail.directions) * (4.0 / self.detail.directions)
        vector = self._summed(each, (normal.shape[1], normal.shape[0]))
        return np.asarray(np.clip(np.einsum("hwi,hwi->hw", vector, normal), 0.0, 1.0), np.float32)

    def shadow(self, light: PointLight, size: Size) -> Float32:
        """(H, W) visible share of a lamp in [0, 1]."""
        chart, points = self._lamp_points
        places = self.casters[0].places(light)
        reached = self.casters[len(places) > 1].lamp(places, points)
        if self.hair is not None:
            reached = reached * self.hair.from_lamp(points[:3].T, light, BIAS["skin"])
        return np.clip(_resized(chart.fill_outside(chart.spread(reached[:, None])), size)[..., 0], 0.0, 1.0)

    def _summed(self, each: Float64, size: Size) -> Float32:
        """(H, W, C) of the sum over directions of visibility times (D, C)."""
        codes, total = self.sky.reshape(len(self.sky), -1), np.zeros((self.sky[0].size, each.shape[1]), np.float32)
        for first in range(0, len(codes), 64):
            part = codes[first : first + 64].astype(np.float32) * np.float32(1 / 255)
            total += part.T @ each[first : first + 64].astype(np.float32)
        return _resized(total.reshape(*self.sky.shape[1:], -1), size)


def _resized(image: Float32, size: Size) -> Float32:
    """(H, W, C) bilinear values of an image (h, w, C), of any number of channels, at ``size`` (width, height)."""
    import cv2

    planes = np.ascontiguousarray(np.moveaxis(image, 2, 0))
    return np.stack([np.asarray(cv2.resize(plane, size)) for plane in planes], -1)


def _points(chart: Chart, vertices: AnyFloat) -> Float32:
    """(6, N) position in mm and smooth unit normal of the inner texels."""
    normal = chart.normals(vertices).reshape(-1, 3)[chart.texels]
    return np.ascontiguousarray(np.concatenate([chart.inside(vertices) * np.float32(1000), normal], 1).T)
