"""Single teeth drawn at the full resolution of the map.

The head's rows of teeth are two smooth bands, and a texel of the photo's texture is a third of a tooth wide. What
separates teeth is drawn: gaps that open towards the incisal edge, sides that turn away, a translucent edge.
"""

from __future__ import annotations

import numpy as np

from service.anatomy.part_texels import PartTexels
from service.anatomy.teeth.paint import biting_height, crown_share
from service.arrays import Float32, Float64
from service.colour import FULL_CODE, Codes, linear_to_srgb, srgb_to_linear
from service.head.model import HeadModel

WIDTHS_MM = {
    "teeth_upper": (8.5, 6.5, 7.5, 7.0, 7.0, 10.5, 10.0),
    "teeth_lower": (5.3, 5.8, 6.8, 7.0, 7.1, 11.0, 10.5),
}
"""Widths of the crowns from the midline outwards (Ash and Nelson, Wheeler's Dental Anatomy)."""

GAP_MM, OPEN_MM, CLOSES_MM = 0.10, 0.32, 1.3
"""Half width of a gap, how much wider it is at the incisal edge, and the height over which that falls to 1/e."""

GAP_DARK, SIDE_DARK = 0.75, 0.12
"""Share of the light that is lost in a gap, and on the side of a tooth, which turns away."""

EDGE_MM, EDGE = 0.9, (0.12, 0.07, 0.02)
"""Height of the translucent incisal edge, and the share of red, green and blue lost there: the dark mouth shines
through."""

POINTS = 400
"""Samples of the dental arch, along which widths are measured."""


def along_arch(points: Float64, vertices: Float64) -> Float64:
    """(N,) millimetres along the dental arch from the midline, > 0 to the subject's left, of points (N, 3) in metres.

    The arch is the parabola z = z0 - k x^2 fitted to the vertices (M, 3) of the row.
    """
    from scipy.spatial import cKDTree

    x, z = vertices[:, 0], vertices[:, 2]
    basis = np.stack([np.ones_like(x), -x * x], 1)
    front, curvature = np.linalg.lstsq(basis, z, rcond=None)[0]
    reach = np.linspace(-1.1, 1.1, POINTS) * max(float(np.abs(x).max()), 1e-4)
    arch = np.stack([reach, front - curvature * reach**2], 1)
    step = np.linalg.norm(np.diff(arch, axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(step)])
    length -= np.interp(0.0, reach, length)
    return np.asarray(1e3 * length[cKDTree(arch).query(points[:, [0, 2]])[1]])


def draw_teeth(albedo: Codes, head: HeadModel, detail: float = 1.0) -> Codes:
    """The albedo, changed in place: rows of teeth are divided into single teeth.

    Args:
        albedo: (H, W, 3) codes of sRGB.
        head: whose chart it is; the albedo stays as it is where the head has no teeth.
        detail: strength in [0, 1].
    """
    for name, widths in WIDTHS_MM.items():
        place = PartTexels.of(head, name, (albedo.shape[1], albedo.shape[0]))
        if place is None:
            continue
        upper = name == "teeth_upper"
        along = along_arch(place.points, place.vertices)
        height = 1e3 * biting_height(place.points, place.vertices, upper=upper)
        texel = _texel_mm(along, height)
        crown = crown_share(place.points, place.vertices, upper=upper)[:, None]
        share = 1 - np.float32(detail) * crown * (1 - _kept_light(along, height, np.array(widths), texel))
        colour = srgb_to_linear(albedo[place.box][place.inside] * np.float32(1 / FULL_CODE)) * share
        drawn = np.rint(linear_to_srgb(np.clip(colour, 0, 1).astype(np.float32)) * FULL_CODE)
        albedo[place.box][place.inside] = drawn.astype(albedo.dtype)
    return albedo


def _texel_mm(along: Float64, height: Float64) -> float:
    """Side of a texel in mm: square root of the area of both sides of a row over the number of its texels."""
    area = float(np.ptp(along)) * float(np.ptp(height)) * 2
    return float(np.sqrt(area / max(len(along), 1)))


def _kept_light(along: Float64, height: Float64, widths: Float64, texel: float) -> Float32:
    """(N, 3) share of the light, in [0, 1], that gaps, sides and incisal edge leave.

    Args:
        along: (N,) mm along the arch.
        height: (N,) mm from the incisal edge towards the gum.
        widths: (K,) mm, from the midline outwards.
        texel: mm.
    """
    borders = np.concatenate([-np.cumsum(widths)[::-1], [0.0], np.cumsum(widths)])
    tooth = np.clip(np.searchsorted(borders, along), 1, len(borders) - 1)
    low, high = borders[tooth - 1], borders[tooth]
    distance = np.minimum(np.abs(along - low), np.abs(high - along))
    above = np.maximum(height, 0.0)
    true_half = GAP_MM + OPEN_MM * np.exp(-above / CLOSES_MM)
    half = np.hypot(true_half, 0.5 * texel)
    # A gap narrower than a texel is drawn wider and, to the same extent, paler.
    dark = GAP_DARK * np.minimum(true_half / half, 1.0)
    gap = 1 - dark * np.exp(-((distance / half) ** 2))
    aside = np.clip(np.abs(2 * along - low - high) / np.maximum(high - low, 1e-6), 0, 1)
    side = 1 - SIDE_DARK * aside**4
    translucent = 1 - np.exp(-((above / EDGE_MM) ** 2))[:, None] * np.array(EDGE)
    return np.asarray((gap * side)[:, None] * translucent, np.float32)
