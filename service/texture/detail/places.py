"""Where the texels of a map lie in the photo, and how closely the photo's pixels lie there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import Float32
from service.face.fit.result import Fit
from service.geometry.camera import NEAREST_M
from service.geometry.chart import Chart, chart_points, solve_affine
from service.head.model import HeadModel

SIZE = (768, 512)
"""Chart on which places are drawn; between its texels they are interpolated, as triangles are several texels wide."""


@dataclass(frozen=True)
class Places:
    """Of a chart of ``SIZE``, (h, w, ...) float32, continued beyond the islands.

    Attributes:
        pixel: (h, w, 2) photo pixels x, y, centres at +0.5.
        finest, coarsest: (h, w) photo pixels along the chart's direction in which they lie closest, and in which they
            lie farthest apart, per texel of this chart: the singular values of the Jacobian d pixel / d texel. 0 where
            the surface lies behind the camera or has no area.
        texel_mm: (h, w) side in mm of a square as large as the texel.
    """

    pixel: Float32
    finest: Float32
    coarsest: Float32
    texel_mm: Float32

    @classmethod
    def of(cls, head: HeadModel, fit: Fit) -> Places:
        """Of a fitted head."""
        chart = Chart.build(head, *SIZE)
        before = fit.camera.to_camera(fit.vertices)[:, 2] > NEAREST_M
        pixels = np.where(before[:, None], fit.camera.project(fit.vertices), 0.0)
        flat = chart_points(head, *SIZE)[head.triangle_uv]
        du, dv = solve_affine(flat, pixels[head.triangles])
        values = np.linalg.svd(np.stack([du, dv], -1), compute_uv=False)
        values[~before[head.triangles].all(1)] = 0.0
        e, f, g = np.moveaxis(chart.metric(fit.vertices), 2, 0)
        side = np.sqrt(np.sqrt(np.maximum(e * g - f * f, 0)))
        drawn = chart.gather(values)
        position = fit.camera.project(chart.inside(fit.vertices).astype(np.float64))
        ahead = fit.camera.to_camera(chart.inside(fit.vertices).astype(np.float64))[:, 2] > NEAREST_M
        pixel = chart.spread(np.where(ahead[:, None], position, 0.0))
        planes = np.concatenate([pixel, drawn, side[..., None]], -1).astype(np.float32)
        whole = chart.fill_outside(planes)
        return cls(*(np.ascontiguousarray(whole[..., part]) for part in (slice(0, 2), 2, 3, 4)))

    @property
    def per_mm(self) -> Float32:
        """(h, w) photo pixels per millimetre of the surface, geometric mean of both directions; 0 without area."""
        area = np.sqrt(self.finest * self.coarsest)
        sound = self.texel_mm > 1e-6
        return np.asarray(np.where(sound, area / np.where(sound, self.texel_mm, 1), 0), np.float32)
