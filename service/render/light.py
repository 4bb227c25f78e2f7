"""Light that arrives at the surface of an avatar: what the head hides of sky and lamps."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from service.geometry.chart import Chart
from service.geometry.points import surface_points
from service.head.model import HeadModel
from service.scene.graphs import Graphs
from service.scene.lamps import disc_of
from service.scene.scene import PointLight
from service.scene.sphere import flux_by_direction, spread_directions

Float = npt.NDArray[np.float32]
Size = tuple[int, int]

_CASTERS = ("skin", "eye")


@dataclass(frozen=True)
class Detail:
    """How finely it is looked at what the head hides.

    Attributes:
        directions: into which the sky is divided.
        sky_size: (width, height) of the chart on which they are looked at.
        shadow_size: the same for lamps.
        casters_mm: spacing of the points that cast hard shadows, and of those that cast soft ones and hide the sky.
        narrowest: width of the smallest chart that is lit, a multiple of 3.
    """

    directions: int = 256
    sky_size: Size = (192, 128)
    shadow_size: Size = (768, 512)
    casters_mm: tuple[float, float] = (0.9, 1.8)
    narrowest: int = 384


@dataclass
class Visibility:
    """Which light reaches which texel of a head; each answer is computed when it is asked for, once.

    Args:
        head: topology and chart.
        vertices: (V, 3) metres.
        graphs: the formulas.
        detail: how finely.
    """

    head: HeadModel
    vertices: npt.NDArray[np.floating]
    graphs: Graphs
    detail: Detail = Detail()
    _fine: Float = field(init=False, repr=False)
    _coarse: Float = field(init=False, repr=False)
    _sky: npt.NDArray[np.uint8] | None = field(init=False, default=None, repr=False)

    def __post_init__(self) -> None:
        """Spread the points that cast shadows."""
        cast = np.array([name.split("_")[0] in _CASTERS for name in self.head.part_names])[self.head.triangle_part]
        triangles = self.head.triangles[cast if cast.any() else slice(None)]
        millimetres = np.asarray(self.vertices) * 1000.0
        clouds = (surface_points(millimetres, triangles, spacing) for spacing in self.detail.casters_mm)
        self._fine, self._coarse = (np.ascontiguousarray(cloud.T) for cloud in clouds)

    def sky(self) -> npt.NDArray[np.uint8]:
        """(D, h, w) 255 where the texel sees the direction; about 2 s."""
        if self._sky is None:
            count, spacing = self.detail.directions, self.detail.casters_mm[1]
            chart = Chart.build(self.head, *self.detail.sky_size)
            inside = np.zeros((count, len(chart.texels)), np.uint8)
            points = _points(chart, self.vertices)
            for k, direction in enumerate(spread_directions(count)):
                towards = direction.astype(np.float32)
                lit = self.graphs.lit("lit_from_direction", self._coarse, spacing, points, towards)
                inside[k] = np.rint(lit * 255.0)
            spread = chart.fill_outside(chart.spread(inside.T.astype(np.float32)))
            self._sky = np.ascontiguousarray(np.moveaxis(spread, 2, 0).astype(np.uint8))
        return self._sky

    def sky_light(self, sky: npt.NDArray[np.floating], size: Size) -> Float:
        """(H, W, 3 colours, 3 axes) vector irradiance: the sum of V d flux; its product with a normal is irradiance."""
        count = self.detail.directions
        flux, directions = flux_by_direction(sky, count), spread_directions(count)
        each = (flux[:, :, None] * directions[:, None, :]).reshape(count, 9)
        return self._summed(each, size).reshape(size[1], size[0], 3, 3)

    def openness(self, normal: Float) -> Float:
        """(H, W) ambient occlusion in [0, 1] of smooth normals (H, W, 3)."""
        each = spread_directions(self.detail.directions) * (4.0 / self.detail.directions)
        vector = self._summed(each, (normal.shape[1], normal.shape[0]))
        return np.asarray(np.clip(np.einsum("hwi,hwi->hw", vector, normal), 0.0, 1.0), np.float32)

    def shadow(self, light: PointLight, size: Size) -> Float:
        """(H, W) share in [0, 1] of a lamp that the head lets through."""
        import cv2

        chart = Chart.build(self.head, *self.detail.shadow_size)
        points = _points(chart, self.vertices)
        # The middle of the casters, as the light stage has it.
        centre = (self._fine.min(1) + self._fine.max(1)) / 2000.0
        places = disc_of(light, centre) * 1000.0
        occluders, spacing = ((self._fine, self._coarse)[len(places) > 1], self.detail.casters_mm[len(places) > 1])
        total = np.zeros(len(chart.texels), np.float32)
        for at in places:
            total += self.graphs.lit("lit_from_point", occluders, spacing, points, at.astype(np.float32))
        image = chart.fill_outside(chart.spread(total[:, None] / np.float32(len(places)))[..., 0])
        return np.asarray(np.clip(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR), 0.0, 1.0), np.float32)

    def _summed(self, each: npt.NDArray[np.float64], size: Size) -> Float:
        """(H, W, C) of the sum over directions of visibility times (D, C)."""
        import cv2

        seen = self.sky().reshape(self.detail.directions, -1)
        total = np.zeros((seen.shape[1], each.shape[1]), np.float32)
        for first in range(0, len(seen), 64):
            part = seen[first : first + 64].astype(np.float32) * np.float32(1 / 255)
            total += part.T @ each[first : first + 64].astype(np.float32)
        image = total.reshape(*self.sky().shape[1:], -1)
        planes = [cv2.resize(image[..., k], size, interpolation=cv2.INTER_LINEAR) for k in range(image.shape[2])]
        return np.stack([np.asarray(plane) for plane in planes], -1)


def _points(chart: Chart, vertices: npt.NDArray[np.floating]) -> Float:
    """(6, N) position in mm and smooth unit normal of the inner texels."""
    normal = chart.normals(vertices).reshape(-1, 3)[chart.texels]
    return np.ascontiguousarray(np.concatenate([chart.inside(vertices) * np.float32(1000), normal], 1).T)
