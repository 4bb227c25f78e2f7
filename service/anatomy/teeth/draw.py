"""Single teeth in the detail of the map.

The head has two smooth rows of teeth, and a texel of the photo's texture is a third of a tooth wide. What parts one
tooth from the next is drawn: gaps that open towards the biting edge, sides that turn away, a glassy edge.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.anatomy.part_texels import PartTexels
from service.anatomy.teeth.paint import biting_height, crown_share
from service.colour import FULL_CODE, Codes, linear_to_srgb, srgb_to_linear
from service.head.model import HeadModel

Float = npt.NDArray[np.float32]
Array = npt.NDArray[np.float64]

WIDTHS_MM = {
    "teeth_upper": (8.5, 6.5, 7.5, 7.0, 7.0, 10.5, 10.0),
    "teeth_lower": (5.3, 5.8, 6.8, 7.0, 7.1, 11.0, 10.5),
}
"""Widths of the crowns from the middle outwards (Ash and Nelson, Wheeler's Dental Anatomy)."""
GAP_MM, OPEN_MM, OPENS_MM = 0.10, 0.32, 1.3
"""Half width of a gap, how much wider it is at the biting edge, and over what height it closes."""
GAP_DARK, SIDE_DARK = 0.75, 0.12
"""Share of light that a gap takes, and the side of a tooth, which turns away."""
EDGE_MM, EDGE = 0.9, (0.12, 0.07, 0.02)
"""Height of the glassy biting edge, and what it takes of red, green and blue: the dark mouth shows through."""
POINTS = 400
"""Of the arch, along which teeth are counted."""


def along_arch(points: Array, vertices: Array) -> Array:
    """(N,) millimetres along a row of teeth from the middle, > 0 to the subject's left, of (N, 3) metres on it.

    The arch is the parabola z = z0 - k x^2 through the vertices (M, 3) of the row.
    """
    from scipy.spatial import cKDTree

    x, z = vertices[:, 0], vertices[:, 2]
    basis = np.stack([np.ones_like(x), -x * x], 1)
    front, bend = np.linalg.lstsq(basis, z, rcond=None)[0]
    reach = np.linspace(-1.1, 1.1, POINTS) * max(float(np.abs(x).max()), 1e-4)
    arch = np.stack([reach, front - bend * reach**2], 1)
    step = np.linalg.norm(np.diff(arch, axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(step)])
    length -= np.interp(0.0, reach, length)
    return np.asarray(1e3 * length[cKDTree(arch).query(points[:, [0, 2]])[1]])


def draw_teeth(albedo: Codes, head: HeadModel, detail: float = 1.0) -> Codes:
    """The albedo, changed in place: rows of teeth are parted into teeth.

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
        share = 1 - np.float32(detail) * crown * (1 - _left(along, height, np.array(widths), texel))
        colour = srgb_to_linear(albedo[place.box][place.inside] * np.float32(1 / FULL_CODE)) * share
        drawn = np.rint(linear_to_srgb(np.clip(colour, 0, 1).astype(np.float32)) * FULL_CODE)
        albedo[place.box][place.inside] = drawn.astype(albedo.dtype)
    return albedo


def _texel_mm(along: Array, height: Array) -> float:
    """Size of a texel of a row: its outer surface over the number of its texels, both sides of the row."""
    area = float(np.ptp(along)) * float(np.ptp(height)) * 2
    return float(np.sqrt(area / max(len(along), 1)))


def _left(along: Array, height: Array, widths: Array, texel: float) -> Float:
    """(N, 3) light that gaps, sides and edge leave, in [0, 1]."""
    borders = np.concatenate([-np.cumsum(widths)[::-1], [0.0], np.cumsum(widths)])
    tooth = np.clip(np.searchsorted(borders, along), 1, len(borders) - 1)
    low, high = borders[tooth - 1], borders[tooth]
    apart = np.minimum(np.abs(along - low), np.abs(high - along))
    above = np.maximum(height, 0.0)
    half = np.hypot(GAP_MM + OPEN_MM * np.exp(-above / OPENS_MM), 0.5 * texel)
    # A gap narrower than a texel is as much paler as it is narrower.
    dark = GAP_DARK * np.minimum((GAP_MM + OPEN_MM * np.exp(-above / OPENS_MM)) / half, 1.0)
    gap = 1 - dark * np.exp(-((apart / half) ** 2))
    aside = np.clip(np.abs(2 * along - low - high) / np.maximum(high - low, 1e-6), 0, 1)
    side = 1 - SIDE_DARK * aside**4
    glass = 1 - np.exp(-((above / EDGE_MM) ** 2))[:, None] * np.array(EDGE)
    return np.asarray((gap * side)[:, None] * glass, np.float32)
