"""The shadow of hair's roots on bald skin, where the photo shows hair or the head would have it.

It is pigment between pores and no relief: it darkens the albedo when that is made, and the networks of normals never
see it.
"""

from __future__ import annotations

import numpy as np

from service.anatomy.hair.find import Hair
from service.arrays import Float32
from service.colour import srgb_to_linear
from service.face.reading.parts import HAIR, SKIN
from service.geometry.chart import Chart
from service.geometry.mesh_field import laplacian, smooth_fit, splat
from service.head.regions import vertex_mask
from service.texture.inpainting.grain import grain
from service.texture.segmentation.zones import Zones

OPACITY = 0.5
"""Of the shadow where hair grows densely: skin between roots shows as much again."""
DARKER = 0.8
"""Colour of roots over the mean of the hair's strands: no light gets between them."""
SMOOTHNESS = 0.5
PRIOR_TRUST = 0.01
"""Weights of the density's smoothness and of what is expected where no scalp is seen, relative to a seen texel."""
GRAIN = 0.08
"""Standard deviation of the opacity over its mean, about: roots are points."""


def root_shadow(chart: Chart, parts: Float32 | None, weight: Float32, zones: Zones, hair: Hair) -> Float32:
    """(N,) float32 opacity in [0, 1] of the shadow at the inner texels.

    Args:
        chart: of the head; all is 0 without a region "scalp".
        parts: (N, 13) as ``service.texture.segmentation.covered.parts_at`` gives them; None: nothing was read.
        weight: (N,) of the photo at the texels, before anything was found to hide them.
        zones: of the same texels.
        hair: says whether the unseen scalp has hair.
    """
    head = chart.head
    count = len(head.mean)
    prior = vertex_mask(head, "scalp")[:, None].astype(np.float64)
    if parts is None:
        density = prior
    else:
        both = parts[:, HAIR] + parts[:, SKIN]
        value = (parts[:, HAIR] / np.maximum(both, 1e-6))[:, None]
        known, trust = splat(chart.corners, chart.weights, value, weight * both * zones.scalp * zones.skin, count)
        edges = laplacian(head.triangles[head.triangle_part == head.part_names.index("skin")], count)
        density = np.clip(smooth_fit(edges, known, trust, SMOOTHNESS, prior, PRIOR_TRUST), 0, 1)
    grown = chart.inside(density.astype(np.float32))[:, 0] * _soft(zones.scalp) * zones.skin
    points = np.clip(1 + GRAIN * grain(chart, 1)[:, 0], 0, 2)
    return np.asarray(np.clip(OPACITY * grown * points, 0, 0.95), np.float32)


def darkening(colour: Float32, shadow: Float32, hair: Hair) -> Float32:
    """(N, 3) float32 in [0, 1], linear: what the shadow leaves of the light from sRGB skin (N, 3)."""
    root = np.clip(hair.colour.usual * hair.colour.root * np.float32(DARKER), 0, 1)
    skin = srgb_to_linear(colour)
    left = np.minimum(root / np.maximum(skin, np.float32(1e-3)), 1)  # pale hair never lightens
    return np.asarray(1 + shadow[:, None] * (left - 1), np.float32)


def _soft(scalp: Float32) -> Float32:
    t = np.clip((scalp - 0.15) / 0.7, 0, 1)
    return np.asarray(t * t * (3 - 2 * t), np.float32)
