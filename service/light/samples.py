"""Samples of a lit surface, the planner's input, taken from a chart by the light stage and by the renderer."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, Bool, Float32, Float64, Int64

RING_MM = (0.0, *(0.6,) * 4, *(1.8,) * 4, *(3.8,) * 4)
"""Distance of each place of a sample from its centre, mm: the centre and three rings of four places."""

PLACES = 5
"""Number of places, from the first, at which the fine relief is evaluated."""

AZIMUTHS = 16
"""Directions around the normal in which the fine relief's horizon is known."""


@dataclass(frozen=True)
class SurfaceSamples:
    """K samples spread over the face, of S = 13 places each (``RING_MM``).

    Attributes:
        position: (S, K, 3) metres.
        diffuse_normal: (S, K, 3) unit, head space.
        specular_normal: (P, K, 3) unit, head space; P = 5 (``PLACES``).
        albedo: (S, K, 3) linear diffuse albedo.
        normal, tangent, bitangent: (K, 3) smooth frame.
        specular: (K,) specular albedo s.
        alpha: (K, 2) GGX alpha of both lobes; ``share`` (K,) weight of the first.
        visible: (K, D) in [0, 1], visibility of D spread directions.
        horizon: (P, K, 16) slope of the fine relief's horizon, azimuths counter-clockwise from the tangent.
        weight: (K,) share of the face's texels that the sample stands for, sum 1.
    """

    position: Float64
    diffuse_normal: Float64
    albedo: Float64
    normal: Float64
    tangent: Float64
    bitangent: Float64
    specular_normal: Float64
    specular: Float64
    alpha: Float64
    share: Float64
    visible: Float64
    horizon: Float64
    weight: Float64


Index = Int64


@dataclass(frozen=True)
class LitChart:
    """A head's surface as maps (h, w, C) or (h, w), row 0 = top.

    Attributes:
        position_m: metres, head space.
        normal, tangent, bitangent: smooth unit frame, head space.
        diffuse_normal, specular_normal: unit, head space.
        albedo: linear diffuse albedo in [0, 1].
        specular: specular albedo s in [0, 1].
        alpha: (h, w, 2) GGX alpha of both lobes; ``share`` (h, w) weight of the first.
        texels_per_mm: square root of texels per mm^2.
        skin: (h, w) bool, texels where light scatters.
    """

    position_m: Float32
    normal: Float32
    tangent: Float32
    bitangent: Float32
    diffuse_normal: Float32
    specular_normal: Float32
    albedo: Float32
    specular: Float32
    alpha: Float32
    share: Float32
    texels_per_mm: Float32
    skin: Bool


def survey(
    chart: LitChart, weight: AnyFloat, offsets: Float64, visible: Callable[[Index], Float64],
    horizon: Callable[[Index], Float64],
) -> SurfaceSamples:  # fmt: skip
    """Stratified samples of the texels by weight; where all weights are 0, of the skin; without skin, of all texels.

    Args:
        chart: the surface at the resolution that is lit, as coarse maps have no relief shadows.
        weight: (h, w) >= 0, sampling density.
        offsets: (K,) in [0, 1), position of each sample within its stratum.
        visible: (K,) flat texels -> (K, D) in [0, 1], visibility of the spread directions.
        horizon: (K,) flat texels -> (K, 16) slope of the fine relief's horizon.
    """
    height, width = chart.skin.shape
    weight = np.asarray(weight, np.float64)
    for fallback in (chart.skin.astype(np.float64), np.ones((height, width))):
        if weight.sum() < 1e-3:
            weight = fallback
    count, total = len(offsets), weight.ravel().cumsum()
    spots = (np.arange(count) + offsets) / count * total[-1]
    index = np.minimum(np.searchsorted(total, spots), height * width - 1)
    density = _pick(chart.texels_per_mm, index)[:, 0]
    rings = [_beside(density, index, place, width, height) for place in range(len(RING_MM))]
    places = _on_skin(rings, chart.skin.ravel())

    def all_places(image: AnyFloat, count: int = len(places)) -> Float64:
        return np.stack([_pick(image, at) for at in places[:count]])

    return SurfaceSamples(
        position=all_places(chart.position_m),
        diffuse_normal=all_places(chart.diffuse_normal),
        albedo=all_places(chart.albedo).clip(0.0, 1.0),
        normal=_pick(chart.normal, index),
        tangent=_pick(chart.tangent, index),
        bitangent=_pick(chart.bitangent, index),
        specular_normal=all_places(chart.specular_normal, PLACES),
        specular=_pick(chart.specular, index)[:, 0],
        alpha=_pick(chart.alpha, index).clip(0.03, 1.0),
        share=_pick(chart.share, index)[:, 0].clip(0.0, 1.0),
        visible=visible(index),
        horizon=np.stack([horizon(at) for at in places[:PLACES]]),
        weight=np.full(count, 1.0 / count),
    )


def _pick(image: AnyFloat, index: Index) -> Float64:
    """(K, C) float64 of a map at flat texels."""
    return np.asarray(np.reshape(image, (image.shape[0] * image.shape[1], -1))[index], np.float64)


def _beside(density: Float64, index: Index, place: int, width: int, height: int) -> Index:
    """(K,) flat index of the texel at a place of the rings: circles on the chart, as is the blur of scattering."""
    ring, spoke = divmod(place + 3, 4)
    angle = (spoke + 0.5 * ring) * 0.5 * math.pi
    right, up = (np.rint(density * RING_MM[place] * f(angle)).astype(np.int64) for f in (math.cos, math.sin))
    row, column = np.clip(index // width - up, 0, height - 1), np.clip(index % width + right, 0, width - 1)
    return np.asarray(row * width + column)


def _on_skin(places: list[Index], skin: Bool) -> list[Index]:
    """Places off the skin, which scatter no light, replaced by the opposite place of their ring, or else the centre."""
    result = places[:1]
    for k, at in enumerate(places[1:], 1):
        opposite = places[(k - 1) // 4 * 4 + (k + 1) % 4 + 1]
        result.append(np.where(skin[at], at, np.where(skin[opposite], opposite, places[0])))
    return result
