"""Roughness of one GGX lobe that stands for both of the skin's: by region, and by how oily the skin is.

Regions have the factors of the light stage (``models/lightstage/skin/base.py``), from which the networks learnt.
"""

from __future__ import annotations

import numpy as np

from service.arrays import Float32, UInt16
from service.geometry.chart import Chart
from service.head.regions import vertex_mask
from service.materials.of_head import SKIN, material_of

FOREHEAD, NOSE, CHEEK, NECK, LIPS = -0.1, -0.17, 0.1, 0.05, -0.25
"""What each region adds to the factor of GGX alpha; that of the nose for oily skin, dry skin has half of it."""

USUAL_OIL = 0.5
OILY_RATIO = 0.3
"""How much more specular nose and forehead are than the cheeks on oily skin; half of it is usual."""

LEAST_TEXELS = 30
"""Fewest texels of a region for its mean to count."""


def oil_of(chart: Chart, specular: UInt16 | None) -> float:
    """How oily the skin is, 0 to 1: by how much the T of forehead and nose is more specular than the cheeks.

    Args:
        chart: at the size of ``specular``.
        specular: (h, w) codes of specular albedo; without it, or where a region is too small, ``USUAL_OIL``.
    """
    if specular is None:
        return USUAL_OIL
    values = specular.reshape(-1)[chart.texels].astype(np.float64)
    zone, cheek = (chart.inside(vertex_mask(chart.head, *names))[:, 0] > 0.7 for names in (_T_ZONE, _CHEEKS))
    if min(zone.sum(), cheek.sum()) < LEAST_TEXELS or values[cheek].mean() <= 0:
        return USUAL_OIL
    # The median, as hair over the forehead is dull.
    ratio = np.median(values[zone]) / max(float(np.median(values[cheek])), 1.0)
    return float(np.clip((ratio - 1) / OILY_RATIO, 0, 1))


_T_ZONE = ("forehead", "nose")
_CHEEKS = ("cheek_left", "cheek_right")


def roughness(chart: Chart, oil: float) -> Float32:
    """(h, w) float32 square root of GGX alpha in [0, 1] on all islands, padded outside.

    Args:
        chart: of the head.
        oil: as :func:`oil_of`.
    """
    head = chart.head
    shares = {
        "forehead": FOREHEAD, "nose": NOSE * (0.5 + 0.5 * oil), "neck": NECK, "lips": LIPS,
    }  # fmt: skip
    factor = 1 + sum(share * vertex_mask(head, name) for name, share in shares.items())
    factor = factor + CHEEK * vertex_mask(head, *_CHEEKS)
    alpha = SKIN.roughness**2 * factor
    drawn = chart.inside(np.sqrt(alpha))
    for index, name in enumerate(head.part_names):
        material = material_of(name)
        if not material.detailed:
            drawn[chart.inner_part == index] = material.roughness
    return np.asarray(chart.fill_outside(chart.spread(drawn)), np.float32)[..., 0]
