"""Visibility of sky and lamps from the surface of a head: depth maps, ambient occlusion and cast shadows."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from service.arrays import AnyFloat, Bool, Float32, Float64, Int64, UInt8
from service.geometry.chart import Chart
from service.geometry.sampling import surface_points
from service.head.model import HeadModel
from service.light.environment import flux_by_direction, spread_directions
from service.light.formulas import Graphs, disc_of
from service.light.scene import PointLight


def sky_seen(graphs: Graphs, count: int, points: Float32, occluders: Float32, spacing: float) -> UInt8:
    """(count, N) visibility of spread directions from points (6, N), 255 = fully visible; 0 below their horizon.

    Args:
        graphs: the formulas.
        count: of directions (``spread_directions``).
        points: position in mm and unit normal.
        occluders: (3, M) mm.
        spacing: of the occluders, mm.
    """
    seen = np.zeros((count, points.shape[1]), np.uint8)
    for k, direction in enumerate(spread_directions(count)):
        if not (direction @ points[3:] > 0).any():
            continue
        lit = graphs.lit("lit_from_direction", occluders, spacing, points, direction.astype(np.float32))
        seen[k] = np.rint(lit * 255.0)
    return seen


def lamp_seen(graphs: Graphs, places: AnyFloat, points: Float32, occluders: Float32, spacing: float) -> Float32:
    """(N,) mean share in [0, 1] of the light from places (K, 3) mm that reaches points; others as of `sky_seen`."""
    total = np.zeros(points.shape[1], np.float32)
    for at in places:
        total += graphs.lit("lit_from_point", occluders, spacing, points, at.astype(np.float32))
    return total / np.float32(len(places))


def summed(seen: UInt8, each: Float64) -> Float32:
    """(N, C) sums over directions of visibility codes (D, N) times (D, C)."""
    total = np.zeros((seen.shape[1], each.shape[1]), np.float32)
    for first in range(0, len(seen), 64):
        part = seen[first : first + 64].astype(np.float32) * np.float32(1 / 255)
        total += part.T @ each[first : first + 64].astype(np.float32)
    return total


Size = tuple[int, int]

REACH_MM = 40.0
"""Distance from an eye's centre up to which geometry casts shadows on it; brows, nose and lids lie within."""


@dataclass(frozen=True)
class Eyes:
    """Eyes and the geometry around them.

    Attributes:
        chart: on which they are lit.
        index: (n,) of their texels among the chart's inner ``texels``.
        occluders: (3, M) mm.
        spacing_mm: of the occluders.
    """

    chart: Chart
    index: Int64
    occluders: Float32
    spacing_mm: float

    @classmethod
    def of(
        cls,
        chart: Chart,
        vertices: AnyFloat,
        casts: Bool,
        spacing: float,
    ) -> Eyes | None:
        """The eyes of a head; None where it has none, or the chart is so coarse that they have no texel.

        Args:
            chart: of the head, on which they are to be lit.
            vertices: (V, 3) metres.
            casts: (T,) triangles that cast shadows.
            spacing: of the points that cast shadows, mm.
        """
        head = chart.head
        parts = [index for index, name in enumerate(head.part_names) if name.startswith("eye")]
        index = np.flatnonzero(np.isin(chart.inner_part, parts))
        if not len(index):
            return None
        millimetres = np.asarray(vertices, np.float64) * 1000.0
        near = np.zeros(len(millimetres), bool)
        for part in parts:
            eye = millimetres[np.unique(head.triangles[head.triangle_part == part])]
            if len(eye):
                near |= np.linalg.norm(millimetres - eye.mean(0), axis=1) < REACH_MM
        cloud = surface_points(millimetres, head.triangles[casts & near[head.triangles].any(1)], spacing)
        return cls(chart, index, np.ascontiguousarray(cloud.T), spacing)

    def over(self, image: Float32, values: Float32) -> Float32:
        """(H, W, C) image of the whole chart with its eyes replaced by values (n, C)."""
        stacked = np.zeros((len(self.chart.texels), values.shape[1] + 1), np.float32)
        stacked[self.index] = np.c_[values, np.ones(len(self.index), np.float32)]
        there = resized(self.chart.spread(stacked), (image.shape[1], image.shape[0]))
        share = there[..., -1:]
        return np.where(share > 0.5, there[..., :-1] / np.maximum(share, 0.5), image).astype(np.float32)


def resized(image: Float32, size: Size) -> Float32:
    """(H, W, C) bilinear values of an image (h, w, C), of any number of channels, at ``size`` (width, height)."""
    import cv2

    return np.stack(
        [np.asarray(cv2.resize(plane, size)) for plane in np.ascontiguousarray(np.moveaxis(image, 2, 0))], -1
    )


_CASTERS = ("skin", "eye")
"""First words of the names of parts that cast shadows."""


@dataclass(frozen=True)
class Detail:
    """Resolution of the visibility.

    Attributes:
        directions: into which the sky is divided.
        sky_size: (width, height) of the chart on which the sky's visibility is computed.
        shadow_size: the same for lamps.
        casters_mm: spacing of the points that cast hard shadows, and of those that cast soft ones and hide the sky.
        eyes_mm: spacing of the points that shade the eyes, which are lit on the chart of ``shadow_size``.
        narrowest: width of the smallest chart that is lit, a multiple of 3.
    """

    directions: int = 256
    sky_size: Size = (192, 128)
    shadow_size: Size = (768, 512)
    casters_mm: tuple[float, float] = (0.9, 1.8)
    eyes_mm: float = 0.45
    narrowest: int = 384


@dataclass
class Visibility:
    """Light that reaches the texels of a head; each result is computed on first use.

    Args:
        head: topology and chart.
        vertices: (V, 3) metres.
        graphs: the formulas.
        detail: the resolution.
    """

    head: HeadModel
    vertices: AnyFloat
    graphs: Graphs
    detail: Detail = Detail()
    _fine: Float32 = field(init=False, repr=False)
    _coarse: Float32 = field(init=False, repr=False)
    _sky: UInt8 | None = field(init=False, default=None, repr=False)

    def __post_init__(self) -> None:
        """Sample the triangles that cast shadows."""
        triangles = self.head.triangles[self.casts]
        millimetres = np.asarray(self.vertices) * 1000.0
        clouds = (surface_points(millimetres, triangles, spacing) for spacing in self.detail.casters_mm)
        self._fine, self._coarse = (np.ascontiguousarray(cloud.T) for cloud in clouds)

    @cached_property
    def casts(self) -> Bool:
        """(T,) bool, triangles that cast shadows; all of them where a head has none of the parts that do."""
        cast = np.array([name.split("_")[0] in _CASTERS for name in self.head.part_names])[self.head.triangle_part]
        return cast if cast.any() else np.ones_like(cast)

    @cached_property
    def _chart(self) -> Chart:
        """Chart on which the visibility of lamps and the light on the eyes are computed."""
        return Chart.build(self.head, *self.detail.shadow_size)

    @cached_property
    def _at(self) -> Float32:
        """(6, N) points of :attr:`_chart`."""
        return _points(self._chart, self.vertices)

    @cached_property
    def _eyes(self) -> Eyes | None:
        return Eyes.of(self._chart, self.vertices, self.casts, self.detail.eyes_mm)

    def sky(self) -> UInt8:
        """(D, h, w) visibility of each direction, 255 = fully visible; takes about 2 s."""
        if self._sky is None:
            chart = Chart.build(self.head, *self.detail.sky_size)
            seen = sky_seen(
                self.graphs,
                self.detail.directions,
                _points(chart, self.vertices),
                self._coarse,
                self.detail.casters_mm[1],
            )
            spread = chart.fill_outside(chart.spread(seen.T.astype(np.float32)))
            self._sky = np.ascontiguousarray(np.moveaxis(spread, 2, 0).astype(np.uint8))
        return self._sky

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
        # The centre of what casts shadows, as in the light stage.
        centre = (self._fine.min(1) + self._fine.max(1)) / 2000.0
        places = disc_of(light, centre) * 1000.0
        occluders, spacing = ((self._fine, self._coarse)[len(places) > 1], self.detail.casters_mm[len(places) > 1])
        reached = lamp_seen(self.graphs, places, self._at, occluders, spacing)
        shown = resized(self._chart.fill_outside(self._chart.spread(reached[:, None])), size)
        if (eyes := self._eyes) is not None:
            points = np.ascontiguousarray(self._at[:, eyes.index])
            shown = eyes.over(shown, lamp_seen(self.graphs, places, points, eyes.occluders, eyes.spacing_mm)[:, None])
        return np.clip(shown[..., 0], 0.0, 1.0)

    def _summed(self, each: Float64, size: Size) -> Float32:
        """(H, W, C) of the sum over directions of visibility times (D, C)."""
        image = summed(self.sky().reshape(self.detail.directions, -1), each).reshape(*self.sky().shape[1:], -1)
        whole = resized(image, size)
        return whole if self._eyes is None else self._eyes.over(whole, summed(self._eyes_sky, each))

    @cached_property
    def _eyes_sky(self) -> UInt8:
        """(D, n) visibility of each direction from the eyes' texels, 255 = fully visible."""
        if self._eyes is None:
            return np.zeros((self.detail.directions, 0), np.uint8)
        points = np.ascontiguousarray(self._at[:, self._eyes.index])
        eyes = self._eyes
        return sky_seen(self.graphs, self.detail.directions, points, eyes.occluders, eyes.spacing_mm)


def _points(chart: Chart, vertices: AnyFloat) -> Float32:
    """(6, N) position in mm and smooth unit normal of the inner texels."""
    normal = chart.normals(vertices).reshape(-1, 3)[chart.texels]
    return np.ascontiguousarray(np.concatenate([chart.inside(vertices) * np.float32(1000), normal], 1).T)
