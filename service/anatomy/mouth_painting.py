"""Teeth, gums, tongue and the lining of the mouth painted on the head's chart, darker the deeper they lie.

Colours are diffuse albedo, linear RGB in [0, 1]. The head's rows of teeth are two smooth bands, and a texel of the
photo's texture is a third of a tooth wide. What separates teeth is drawn at the full resolution of the map: gaps that
open towards the incisal edge, sides that turn away, a translucent edge.
"""

from __future__ import annotations

import numpy as np

from service.anatomy.canvas import PartTexels, part_points
from service.arrays import AnyFloat, Float32, Float64, Int64
from service.colour import FULL_CODE, Codes, linear_to_srgb, luma, srgb_to_linear
from service.geometry.chart import Chart
from service.head.model import HeadModel

TONGUE = np.array([0.357, 0.114, 0.107], np.float32)
"""Top of the tongue."""

LINING = np.array([0.40, 0.150, 0.135], np.float32)
"""Mucosa that lines the mouth: inside of lips and cheeks, palate. A little redder than gums."""


HALF_DEPTH_M = {"tongue": 0.030, "lining": 0.080}
"""Metres behind the foremost point of each at which its sRGB values have halved. The lining stays red: how little light
reaches the throat is the renderer's, and with too dark a lining a path tracer shows a black hole."""


def shade(depth: AnyFloat, half: float) -> Float32:
    """(N, 1) factor in (0, 1] on sRGB values at depths (N,) behind the front: 1/2 at ``half``, 1 at depths below 0."""
    return np.asarray(1.0 / (1.0 + (np.maximum(depth, 0.0) / half) ** 1.5), np.float32)[:, None]


def paint_tongue(chart: Chart, index: int, texels: Int64) -> Float32:
    """(n, 3) sRGB-coded albedo of the tongue at texels (n,) of part ``index``, darker towards the throat."""
    points, vertices = part_points(chart, index, texels)
    depth = vertices[:, 2].max() - points[:, 2]
    return np.asarray(linear_to_srgb(TONGUE) * shade(depth, HALF_DEPTH_M["tongue"]), np.float32)


def paint_lining(chart: Chart, mouth: Float32) -> Float32:
    """(N, 3) sRGB-coded albedo of the lining at all inner texels; ``mouth`` (N,) > 0.5 marks those on it."""
    head = chart.head
    inside = mouth > 0.5
    depth = np.zeros(len(mouth))
    if inside.any():
        z = np.einsum("nk,nk->n", chart.weights[inside], head.mean[chart.corners[inside], 2])
        depth[inside] = z.max() - z
    return np.asarray(linear_to_srgb(LINING) * shade(depth, HALF_DEPTH_M["lining"]), np.float32)


GUMS = np.array([0.41, 0.157, 0.143], np.float32)
"""Wet gums."""

WHITEST = (0.96, 0.92)
"""Largest reflectance of teeth in green and blue, over that in red: even bleached ones are yellower."""


def crown_share(points: AnyFloat, vertices: AnyFloat, *, upper: bool) -> Float32:
    """(N,) in [0, 1], 1 on the crown of a tooth, 0 on the gum; arguments as of :func:`biting_height`."""
    # Metres from the incisal edge: up to the first all is crown, from the second on all is gum.
    low, high = (0.0095, 0.0115)
    height = biting_height(points, vertices, upper=upper)
    return np.asarray(np.clip((high - height) / (high - low), 0.0, 1.0), np.float32)


def biting_height(points: AnyFloat, vertices: AnyFloat, *, upper: bool) -> Float64:
    """(N,) metres from the incisal edge towards the gum.

    Args:
        points: (N, 3) metres on a row of teeth.
        vertices: (M, 3) metres of that row; its edge near a point is the lowest of them (upper row) or the highest.
        upper: whether it is the upper row.
    """
    sign = 1.0 if upper else -1.0
    distance = np.linalg.norm(points[:, None, [0, 2]] - vertices[None, :, [0, 2]], axis=2)
    # Vertices within this horizontal distance, metres, belong to the same tooth.
    near = distance <= np.maximum(0.005, distance.min(1, keepdims=True) + 1e-6)
    edge = np.where(near, sign * vertices[None, :, 1], np.inf).min(1)
    return np.asarray(sign * points[:, 1] - edge)


class Teeth:
    """Both rows of teeth on the chart.

    Attributes:
        own: (n,) int64 indices of their texels among the inner ones.
        depth: (n,) float32 metres behind the foremost tooth of the same row, in the neutral mean head.
        crown: (n,) float32 in [0, 1], 1 on crowns and 0 on gums.
    """

    def __init__(self, chart: Chart) -> None:
        """Of any head; n is 0 where it has no teeth."""
        own, depth, crown = [], [], []
        for index, name in enumerate(chart.head.part_names):
            texels = np.flatnonzero(chart.inner_part == index)
            if not name.startswith("teeth") or not len(texels):
                continue
            points, vertices = part_points(chart, index, texels)
            own.append(texels)
            depth.append((vertices[:, 2].max() - points[:, 2]).astype(np.float32))
            crown.append(crown_share(points, vertices, upper=not name.endswith("lower")))
        none = np.zeros(0, np.float32)
        self.own: Int64 = np.concatenate(own) if own else np.zeros(0, np.int64)
        self.depth: Float32 = np.concatenate(depth) if depth else none
        self.crown: Float32 = np.concatenate(crown) if crown else none

    def paint(self, tooth: Float32) -> Float32:
        """(n, 3) sRGB-coded albedo: teeth of a sRGB-coded colour (3,) at the front, darker the deeper they lie."""
        gums = linear_to_srgb(GUMS)
        flat = gums + self.crown[:, None] * (tooth - gums)
        # Metres behind the front tooth at which a tooth's sRGB values have halved.
        return np.asarray(flat * shade(self.depth, 0.028), np.float32)

    def shows(self, colour: Float32, tooth: Float32) -> Float32:
        """(n,) in [0, 1]: how far the photo's sRGB colours (n, 3) are tooth (3,) rather than gap, shadow or gum."""
        bright = luma(colour) / max(float(luma(tooth)), 1e-3)
        # Luma over the measured tooth's up to which the photo shows a gap or a shadow, and from which on it shows
        # teeth.
        low, high = (0.60, 0.80)
        return np.asarray(np.clip((bright - low) / (high - low), 0.0, 1.0), np.float32)


def no_bluer(albedo: Float32) -> Float32:
    """(n, 3) sRGB-coded albedo of teeth whose green and blue over red are at most ``WHITEST``.

    Without this limit teeth can come out cyan: the sclera, which gives the light, lies deeper than the front teeth and
    receives more light reflected by skin; and the brightest teeth are overexposed.
    """
    linear = srgb_to_linear(albedo)
    linear[:, 1:] = np.minimum(linear[:, 1:], linear[:, :1] * np.array(WHITEST, np.float32))
    return linear_to_srgb(linear)


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


def along_arch(points: Float64, vertices: Float64) -> Float64:
    """(N,) millimetres along the dental arch from the midline, > 0 to the subject's left, of points (N, 3) in metres.

    The arch is the parabola z = z0 - k x^2 fitted to the vertices (M, 3) of the row.
    """
    from scipy.spatial import cKDTree

    x, z = vertices[:, 0], vertices[:, 2]
    basis = np.stack([np.ones_like(x), -x * x], 1)
    front, curvature = np.linalg.lstsq(basis, z, rcond=None)[0]
    # Samples of the dental arch, along which widths are measured.
    reach = np.linspace(-1.1, 1.1, 400) * max(float(np.abs(x).max()), 1e-4)
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
