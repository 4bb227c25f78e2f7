"""Visibility of sky and lamps from the surface of a head: ambient occlusion and cast shadows."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from service.arrays import AnyFloat, Bool, Float32, Float64, UInt8
from service.geometry.chart import Chart
from service.geometry.points import surface_points
from service.head.model import HeadModel
from service.light.graphs import Graphs
from service.light.lamps import disc_of
from service.light.scene import PointLight
from service.light.sphere import flux_by_direction, spread_directions
from service.render.eyes import Eyes, resized
from service.render.occlusion import lamp_seen, sky_seen, summed

Size = tuple[int, int]

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
