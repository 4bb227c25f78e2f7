"""Maps of the surface that need no network: roughness, cavity and thickness.

- Roughness of one GGX lobe that stands for both of the skin's: by region. Regions have the factors of the light stage
  (``models/lightstage/skin/base.py``), from which the networks learnt; lips are wetter.
- Cavity: how much of the sky the relief leaves open, in pores, folds and wrinkles.
- Thickness of the flesh under the skin: how far it is to the other side of an ear, a nostril, a lid.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, fields

import numpy as np

from service.arrays import AnyFloat, Float32, UInt8, UInt16
from service.geometry.chart import Chart
from service.geometry.mesh import vertex_normals
from service.head.model import HeadModel
from service.head.regions import part_vertices, vertex_mask
from service.image_filters import blurred, resized, shrunk
from service.materials.part import SKIN, material_of
from service.reflectance.reflectance_maps import SCALE_MM, Reflectance
from service.reflectance.subject import GEOMETRY_SIZE, coarse_chart

FINE = (0.25, 0.03)
COARSE = (0.8, 0.06)
"""Standard deviation of the blur whose depth counts, and the depth that hides a sky, both in mm: the light stage's
(``models/lightstage/skin/gloss.py``)."""

WIDEST = 16.0
"""Largest standard deviation in texels; a head smaller than a thumb would ask for more."""

STRENGTH = 1.5
FLOOR = 0.35
"""Even the deepest pore sees this share."""


def cavity(displacement: UInt16, texel_mm: float, size: tuple[int, int]) -> Float32:
    """(h, w) float32 in [``FLOOR``, 1] of a displacement map (H, W).

    The depth below the mean of the surroundings at two scales, through exp(-depth).

    Args:
        displacement: codes of heights, ``SCALE_MM`` apart.
        texel_mm: size of a texel of the result on the face, mm.
        size: (width, height) of the result.
    """
    height = shrunk(displacement, size) * np.float32(SCALE_MM)
    depth = np.zeros_like(height)
    for sigma_mm, hidden_mm in (FINE, COARSE):
        sigma = min(max(sigma_mm / max(texel_mm, 1e-6), 0.3), WIDEST)
        mean = blurred(height, sigma)
        depth += np.maximum(mean - height, 0) / np.float32(hidden_mm)
    return np.asarray(FLOOR + (1 - FLOOR) * np.exp(-STRENGTH * depth), np.float32)


FOREHEAD, NOSE, CHEEK, NECK, LIPS = -0.1, -0.1275, 0.1, 0.05, -0.55
"""What each region adds to the factor of GGX alpha. Lips are moist: their roughness comes to 0.37."""


def roughness(chart: Chart) -> Float32:
    """(h, w) float32 square root of GGX alpha in [0, 1] on all islands, padded outside."""
    head = chart.head
    shares = {"forehead": FOREHEAD, "nose": NOSE, "neck": NECK, "lips": LIPS}
    factor = 1 + sum(share * vertex_mask(head, name) for name, share in shares.items())
    factor = factor + CHEEK * vertex_mask(head, "cheek_left", "cheek_right")
    alpha = SKIN.roughness**2 * factor
    drawn = chart.inside(np.sqrt(alpha))
    for index, name in enumerate(head.part_names):
        material = material_of(name)
        if not material.detailed:
            drawn[chart.inner_part == index] = material.roughness
    return np.asarray(chart.fill_outside(chart.spread(drawn)), np.float32)[..., 0]


LARGEST_MM = 25.5
"""Thickness from which on it is called thick: hardly any light comes through."""

LEAST_COSINE = 0.3
"""Least cosine between the inward normal and the way to a point that bounds the ball. A neighbour on the same smooth
side has a smaller one, and only says how the surface is curved there, with the error of its normal."""

_BLOCK = 64
"""Vertices that are compared with all others at once: their tables stay in the processor's cache."""


def flesh_mm(head: HeadModel, vertices: AnyFloat) -> Float32:
    """(V,) float32 diameter in mm of the largest ball under each vertex of the skin, at most ``LARGEST_MM``.

    Other parts than the skin have ``LARGEST_MM``.

    The ball touches the surface at p with inward normal m, and holds no other vertex: of all q, its radius is the least
    |q - p|^2 / (2 m.(q - p)) (the shrinking ball of Ma, Bae and Choi 2012, solved over all points at once).

    Args:
        head: topology; the skin is its first part.
        vertices: (V, 3) metres.
    """
    result = np.full(len(vertices), LARGEST_MM, np.float32)
    own = part_vertices(head, head.part_names[0]) if head.part_names else np.zeros(0, np.int32)
    if not len(own):
        return result
    points = np.asarray(vertices, np.float64)[own] * 1e3
    inward = -vertex_normals(vertices, head.triangles)[own]
    centred = (points - points.mean(0)).astype(np.float32)
    m = inward.astype(np.float32)
    square = np.einsum("ni,ni->n", centred, centred)
    order = np.argsort(centred[:, 1], kind="stable")  # a ball touches nothing that is higher or lower by its width
    own, centred, m, square = own[order], centred[order], m[order], square[order]
    for first in range(0, len(own), _BLOCK):
        p, direction = centred[first : first + _BLOCK], m[first : first + _BLOCK]
        reach = np.searchsorted(centred[:, 1], (p[0, 1] - LARGEST_MM, p[-1, 1] + LARGEST_MM))
        q = centred[slice(*reach)]
        distance2 = np.maximum(square[first : first + _BLOCK, None] + square[slice(*reach)] - 2 * p @ q.T, 0)
        along = direction @ q.T - np.einsum("ni,ni->n", direction, p)[:, None]
        facing = along > LEAST_COSINE * np.sqrt(distance2)
        facing &= distance2 > 1e-4  # not the vertex itself
        along[~facing] = 0.0  # their balls are infinite: faster than to divide the others alone
        with np.errstate(divide="ignore", invalid="ignore"):
            balls = distance2 / along
        result[own[first : first + _BLOCK]] = np.fmin(np.fmin.reduce(balls, 1), LARGEST_MM)
    return result


LARGEST = (1152, 768)
"""Largest size of these maps: a texel is a third of a millimetre on the face, and they show little that is finer. Of
smaller ones they have half the sides."""

CODES_PER_MM = 10
"""Of thickness."""


@dataclass(frozen=True)
class SurfaceMaps:
    """Maps on the head's chart, (h, w) uint8, padded outside the islands; None: not requested, or not to be had.

    Attributes:
        roughness: 255 = 1, square root of GGX alpha.
        cavity: 255 = 1, share of the sky that the relief leaves open.
        thickness: ``CODES_PER_MM``; 255 is thick.
    """

    roughness: UInt8 | None = None
    cavity: UInt8 | None = None
    thickness: UInt8 | None = None


def surface_maps(
    head: HeadModel,
    vertices: AnyFloat,
    made: Reflectance | None,
    roles: Collection[str],
    size: tuple[int, int],
    flesh: Float32 | None = None,
) -> SurfaceMaps | None:
    """The maps among ``roles``; None where none of them is.

    Args:
        head: topology, chart and regions.
        vertices: (V, 3) metres.
        made: displacement says where its cavities are.
        roles: maps that were requested.
        size: (width, height) of the other maps.
        flesh: of ``flesh_mm``, where it is known already.
    """
    wanted = set(roles) & {one.name for one in fields(SurfaceMaps)}
    if not wanted:
        return None
    size = min((max(size[0] // 2, 1), max(size[1] // 2, 1)), LARGEST)
    chart = Chart.build(head, *size) if size < GEOMETRY_SIZE else coarse_chart(head)
    relief = None if made is None else made.displacement
    thick = chart.fill_outside(chart.interpolate(flesh_mm(head, vertices) if flesh is None else flesh))[..., 0]
    open_sky = None if relief is None else cavity(relief, _texel_mm(head, vertices, size[0]), size)
    return SurfaceMaps(
        roughness=_codes(resized(roughness(chart), size), 255) if "roughness" in wanted else None,
        cavity=_codes(open_sky, 255) if "cavity" in wanted and open_sky is not None else None,
        thickness=_codes(resized(thick, size), CODES_PER_MM) if "thickness" in wanted else None,
    )


def _texel_mm(head: HeadModel, vertices: AnyFloat, width: int) -> float:
    """Median size of a texel of the face, mm: edges of the mesh over those of the chart, which is ``width`` wide."""
    face = head.region("face") if "face" in head.region_names else np.ones(len(head.mean), np.float32)
    chosen = (face[head.triangles] > 0.5).all(1) & (head.triangle_part == 0)
    if not chosen.any():
        chosen = head.triangle_part == 0
    corners = np.asarray(vertices, np.float64)[head.triangles[chosen]]
    places = head.uv.astype(np.float64)[head.triangle_uv[chosen]] * (width, width * 2 / 3)
    length, texels = (np.linalg.norm(one[:, 1] - one[:, 0], axis=1) for one in (corners, places))
    return float(np.median(length * 1e3 / np.maximum(texels, 1e-9))) if len(length) else 1.0


def _codes(values: Float32 | None, scale: float) -> UInt8 | None:
    return None if values is None else np.rint(np.clip(values * scale, 0, 255)).astype(np.uint8)
