"""How much brighter a surface becomes when its normal turns, in a known light."""

from __future__ import annotations

import numpy as np

from service.arrays import AnyFloat, Float32, Float64
from service.geometry.chart import Chart
from service.light.harmonics import gradient
from service.light.skin_light import BAND_GAIN, LUMINANCE, sh_basis

DARKEST = 0.2
"""Least irradiance, over the mean of the seen skin, by which is divided: darker skin lies in cast shadows, whose light
the harmonics do not know."""


def sensitivity(chart: Chart, vertices: AnyFloat, light: AnyFloat, rotation: AnyFloat) -> Float32:
    """(h, w, 2) float32, d log E / d (x, y) of the tangent-space normal, continued beyond the islands.

    Args:
        chart: of the head.
        vertices: (V, 3) metres.
        light: (9, 3) harmonics of radiance in the camera's frame (``service.face.fit.result.Fit.light``).
        rotation: (3, 3) from the head's frame to the camera's.
    """
    frame, turn = chart.frame(vertices), np.asarray(rotation, np.float64).T

    def seen(axis: Float32) -> Float64:
        return np.asarray(axis.reshape(-1, 3)[chart.texels] @ turn, np.float64)

    grey = np.asarray(light, np.float64) @ LUMINANCE
    normal = seen(frame.normal)
    shade = np.maximum(sh_basis(normal) @ grey, DARKEST)
    slope = gradient(normal, grey * BAND_GAIN) / shade[:, None]
    both = np.stack([(slope * seen(axis)).sum(1) for axis in (frame.tangent, frame.bitangent)], 1)
    return chart.fill_outside(chart.spread(both.astype(np.float32)))
