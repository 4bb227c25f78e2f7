"""Geometry of the chart as smooth maps: where each texel lies on the template and on a subject's own head."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import torch
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from models.lightstage.skin.window import ChartWindow
from service.geometry.chart import Chart, solve_affine
from service.head.model import HeadModel

Float = npt.NDArray[np.float32]

BASE_WIDTH = 1536
BASE_HEIGHT = 1024
_SKIN = 0


def spline_weights(position: Tensor) -> tuple[Tensor, list[Tensor]]:
    """Integer knot and the 4 weights of a uniform cubic B-spline for float64 positions."""
    knot = position.floor()
    t = position - knot
    weights = [
        (1.0 - t) ** 3 / 6.0,
        (3.0 * t**3 - 6.0 * t**2 + 4.0) / 6.0,
        (-3.0 * t**3 + 3.0 * t**2 + 3.0 * t + 1.0) / 6.0,
        t**3 / 6.0,
    ]
    return knot.long(), [w.float() for w in weights]


def enlarge(image: Tensor, window: ChartWindow) -> Tensor:
    """(C, h, w) of a smooth (C, H, W) map of the whole chart at the window's texels, by a cubic B-spline.

    The spline approximates (it blurs by 0.6 map texels) in exchange for continuous second derivatives: metric and
    noise coordinates then show no trace of the map's own grid. Beyond the chart the map goes on with its border values.
    """
    result = image
    for axis, position in ((2, window.columns(image.shape[2])), (1, window.rows(image.shape[1]))):
        count = image.shape[axis]
        knot, weights = spline_weights(position)
        if axis == 2:  # rows that no texel needs are not enlarged
            rows = window.rows(image.shape[1])
            first = max(0, min(int(rows[0].floor()) - 1, image.shape[1] - 1))
            last = max(first, min(int(rows[-1].floor()) + 2, image.shape[1] - 1))
            result = result[:, first : last + 1]
        else:
            knot = knot - first
            count = result.shape[1]
        shape = (1, -1, 1) if axis == 1 else (1, 1, -1)
        total = torch.zeros((), device=image.device)
        for i, weight in enumerate(weights):
            index = (knot + (i - 1)).clamp(0, count - 1).to(image.device)
            total = total + result.index_select(axis, index) * weight.to(image.device).view(shape)
        result = total
    return result


@dataclass(frozen=True)
class Atlas:
    """The template's chart, rasterised once for all subjects.

    Attributes:
        position: (3, H, W) float32 mm, template at rest, continued linearly beyond the island.
        inside: (H, W) float32, 1 on the skin's island.
        edge: (H, W) float32 signed distance to the island's border in chart texels at 6144 columns, positive inside.
        head, chart: the model and its raster at this size; None for a flat piece of skin.
    """

    position: Float
    inside: Float
    edge: Float
    head: HeadModel | None = None
    chart: Chart | None = None

    @classmethod
    def of(cls, head: HeadModel, width: int = BASE_WIDTH, height: int = BASE_HEIGHT) -> Atlas:
        """Rasterise the skin of a head model; other parts of the chart count as outside."""
        chart = Chart.build(head, width, height)
        skin = chart.part == _SKIN
        return cls(_continued(chart, head.mean * 1000.0, skin), skin.astype(np.float32), _edge(skin), head, chart)

    @classmethod
    def flat(cls, texels_per_mm: float = 16.0, width: int = 384, height: int = 256) -> Atlas:
        """A plane piece of skin on which the 6144 x 4096 chart has ``texels_per_mm``; for tests and statistics."""
        x, y = np.meshgrid((np.arange(width) + 0.5) / width * 6144, (np.arange(height) + 0.5) / height * 4096)
        position = np.stack([x - 3072, 2048 - y, np.zeros_like(x)]).astype(np.float32) / texels_per_mm
        return cls(position, np.ones((height, width), np.float32), np.full((height, width), 1e4, np.float32))

    def positions(self, vertices: npt.NDArray[np.floating]) -> Float:
        """(3, H, W) float32 mm for (V, 3) vertices in metres, continued beyond the island."""
        if self.chart is None:
            return self.position
        return _continued(self.chart, np.asarray(vertices) * 1000.0, self.inside > 0.5)

    @cached_property
    def _steps(self) -> tuple[Float, Float]:
        """Change of position (3, H, W) for one map texel to the right and one down."""
        return np.gradient(self.position, axis=2), np.gradient(self.position, axis=1)

    @cached_property
    def area_mm2(self) -> Float:
        """(H, W) float32 template area of each map texel, 0 outside the island."""
        du, dv = self._steps
        e, f, g = (du * du).sum(0), (du * dv).sum(0), (dv * dv).sum(0)
        return np.asarray(np.sqrt(np.maximum(e * g - f * f, 0.0)) * self.inside, np.float32)

    def sample(self, image: npt.NDArray[np.floating], uv: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
        """(N, C) bilinear values of a (C, H, W) map at (N, 2) chart coordinates (v up)."""
        _, height, width = image.shape
        x = np.clip(uv[:, 0] * width - 0.5, 0, width - 1.001)
        y = np.clip((1.0 - uv[:, 1]) * height - 0.5, 0, height - 1.001)
        c, r = x.astype(int), y.astype(int)
        fx, fy = x - c, y - r
        top = image[:, r, c] * (1 - fx) + image[:, r, c + 1] * fx
        low = image[:, r + 1, c] * (1 - fx) + image[:, r + 1, c + 1] * fx
        return np.asarray((top * (1 - fy) + low * fy).T, np.float64)

    def frames(self, uv: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
        """(N, 3) float64 (p, q, r) such that a chart step (du, dv) is p du + q dv mm along u and r dv mm across."""
        _, height, width = self.position.shape
        du, dv = self._steps
        both = self.sample(np.concatenate([du, dv]), uv) * np.repeat([width, -height], 3)
        along = np.maximum(np.linalg.norm(both[:, :3], axis=1), 1e-3)
        skew = (both[:, :3] * both[:, 3:]).sum(1) / along
        across = np.sqrt(np.maximum((both[:, 3:] ** 2).sum(1) - skew**2, 1e-6))
        return np.stack([along, skew, across], 1)


def _continued(chart: Chart, vertices_mm: npt.NDArray[np.floating], inside: npt.NDArray[np.bool_]) -> Float:
    """(3, H, W) positions; beyond the island each texel goes on linearly from the nearest triangle."""
    position = chart.interpolate(vertices_mm)
    head = chart.head
    corners = head.uv[head.triangle_uv].astype(np.float64)
    du, dv = solve_affine(corners, np.asarray(vertices_mm, np.float64)[head.triangles])
    height, width = inside.shape
    rows, columns = np.mgrid[0:height, 0:width]
    out = ~inside
    _, source = distance_transform_edt(out, return_indices=True)
    row, column = source[:, out]
    triangle = chart.triangle[row, column]
    step_u = (columns[out] - column)[:, None] / width
    step_v = (row - rows[out])[:, None] / height
    far = np.hypot(columns[out] - column, rows[out] - row)[:, None]
    damp = 1.0 / (1.0 + far / 24.0)  # a strongly turned triangle must not shoot across the room
    position[out] = position[row, column] + damp * (du[triangle] * step_u + dv[triangle] * step_v)
    return np.ascontiguousarray(position.transpose(2, 0, 1), np.float32)


def _edge(inside: npt.NDArray[np.bool_]) -> Float:
    import cv2

    mask = inside.astype(np.uint8)
    scale = 6144.0 / inside.shape[1]
    within = np.asarray(cv2.distanceTransform(mask, cv2.DIST_L2, 5)) - 0.5
    beyond = np.asarray(cv2.distanceTransform(1 - mask, cv2.DIST_L2, 5)) - 0.5
    return np.asarray(np.where(inside, within, -beyond) * scale, np.float32)


@dataclass(frozen=True)
class Metric:
    """Size of a texel on the surface, (h, w) float32 each: a step of one texel right and up is (p, q; 0, r) mm.

    The first axis runs along +u on the surface, the second across it towards +v.
    """

    p: Tensor
    q: Tensor
    r: Tensor

    @classmethod
    def of(cls, position: Tensor) -> Metric:
        """From (3, h, w) positions in mm by central differences; every size is at least 1e-4 mm."""
        du, dv = central(position, 2), -central(position, 1)
        p = du.square().sum(0).sqrt().clamp(min=1e-4)
        q = (du * dv).sum(0) / p
        r = (dv.square().sum(0) - q * q).clamp(min=1e-8).sqrt()
        return cls(p, q, r)

    def texels_per_mm(self) -> Tensor:
        """(h, w) 1 / sqrt(area of a texel)."""
        return (self.p * self.r).rsqrt()

    def gradient(self, height_mm: Tensor) -> tuple[Tensor, Tensor]:
        """Slopes (mm per mm) of a (h, w) height along the two surface axes, by 3 x 3 Scharr differences."""
        du, dv = _scharr(height_mm, 1), -_scharr(height_mm, 0)
        along = du / self.p
        return along, (dv - self.q * along) / self.r


def central(image: Tensor, axis: int) -> Tensor:
    """Central differences, one-sided at the borders."""
    n = image.shape[axis]
    step = torch.arange(n, device=image.device)
    after, before = (step + 1).clamp(max=n - 1), (step - 1).clamp(min=0)
    span = (after - before).clamp(min=1).view([-1 if i == axis else 1 for i in range(image.ndim)])
    return (image.index_select(axis, after) - image.index_select(axis, before)) / span


def _scharr(image: Tensor, axis: int) -> Tensor:
    slope = central(image, axis)
    n = image.shape[1 - axis]
    step = torch.arange(n, device=image.device)
    before = slope.index_select(1 - axis, (step - 1).clamp(min=0))
    after = slope.index_select(1 - axis, (step + 1).clamp(max=n - 1))
    return (3.0 / 16.0) * (before + after) + (10.0 / 16.0) * slope
