"""Input of the planner for a picture: samples of the visible skin, and the exposure."""

from __future__ import annotations

import numpy as np

from service.arrays import Float64
from service.light import surface as points
from service.light.environment import Illumination
from service.light.exposure import BRIGHT, exposed_for
from service.light.scene import Scene
from service.light.shading import Shading
from service.light.survey import Index, LitChart, survey
from service.render.light import Visibility
from service.render.surface import Surface
from service.render.view import Samples

COUNT = 384
"""Samples of the skin."""
_GOLDEN = 0.6180339887498949
"""Golden ratio less 1: its multiples modulo 1 are spread evenly."""


def samples_of(surface: Surface, visibility: Visibility, seen: Samples) -> points.SurfaceSamples:
    """Samples of the visible skin, with the density of the picture's pixels."""
    s = surface
    height, width = s.specular.shape
    chart = LitChart(
        position_m=s.position_m,
        normal=s.normal,
        tangent=s.tangent,
        bitangent=s.bitangent,
        diffuse_normal=s.diffuse_normal,
        specular_normal=s.specular_normal,
        albedo=s.albedo,
        specular=s.specular,
        alpha=s.alpha,
        share=s.share,
        texels_per_mm=s.texels_per_mm,
        skin=s.skin,
        weight=_weight(seen, height, width) * s.skin,
    )
    offsets = np.asarray(np.arange(COUNT) * _GOLDEN % 1.0, np.float64)

    def visible(at: Index) -> Float64:
        sky = visibility.sky()
        rows, columns = (at // width) * sky.shape[1] // height, (at % width) * sky.shape[2] // width
        return sky[:, rows, columns].T / 255.0

    flat = np.zeros((COUNT, points.AZIMUTHS))
    return survey(chart, offsets, visible, lambda at: flat)


def _weight(seen: Samples, height: int, width: int) -> Float64:
    """(H, W) number of the picture's samples nearest to each texel."""
    column = np.clip((seen.uv[:, 0] * width).astype(np.int64), 0, width - 1)
    row = np.clip(((1 - seen.uv[:, 1]) * height).astype(np.int64), 0, height - 1)
    return np.bincount(row * width + column, minlength=height * width).reshape(height, width).astype(np.float64)


def exposed(scene: Scene, surface: points.SurfaceSamples, light: Illumination) -> Scene:
    """The scene with an exposure that maps the 90th percentile of the samples' luminance to the target.

    A scene that has an exposure is returned unchanged.
    """
    if scene.response.exposure is not None:
        return scene
    return exposed_for(scene, float(np.quantile(Shading(scene, surface, light).luminance(), BRIGHT)))
