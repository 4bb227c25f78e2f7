"""Samples of a lit surface: the planner's input."""

from __future__ import annotations

from dataclasses import dataclass

from service.arrays import Float64

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
