"""Teeth, gums, tongue and lining of the mouth: painted on the head's chart, and as meshes with pictures of their own.

Colours are diffuse albedo, linear RGB in [0, 1]. The head's rows of teeth are two smooth bands; on the chart they are
darker the deeper they lie. The meshes that stand in their place have single teeth, in the photo's tooth colour.
"""

from __future__ import annotations

import numpy as np

from service.anatomy.canvas import Canvas, part_points, smooth_noise
from service.anatomy.items import Inset, fits, following, read_insets
from service.arrays import AnyFloat, Float32, Float64, Int64, UInt8
from service.colour import linear_to_srgb, luma, srgb_to_linear
from service.face.features.mouth import TOOTH
from service.face.fit.fit import Fit
from service.geometry.chart import Chart
from service.geometry.nearest import Nearest
from service.head.model import HeadModel
from service.materials.material import Material, OwnMap
from service.materials.part import MeshPart

TONGUE = np.array([0.357, 0.114, 0.107], np.float32)
"""Top of the tongue."""

LINING = np.array([0.40, 0.150, 0.135], np.float32)
"""Mucosa that lines the mouth: inside of lips and cheeks, palate. A little redder than gums."""


HALF_DEPTH_M = {"tongue": 0.030, "lining": 0.160}
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
    """(N,) metres from the incisal edge towards the gum, of points (N, 3) metres on the upper or lower row of teeth.

    The edge near a point is the lowest of the row's vertices (M, 3) metres (upper row) or the highest.
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


SIZE, TONGUE_SIZE, OPEN_SIZE = 1024, 512, 256
"""Sides of the pictures of teeth and gums, of the tongue, and of how open to the sky the rows lie, texels."""
OPEN_M = 0.014
"""Metres behind the front teeth at which half of the sky's light arrives. Rays from the rows of a mouth that is open by
a quarter to a half find a third of the sky at the front, a tenth 6 to 12 mm behind and 2 to 5 % beyond; mucosa and
teeth send on the rest. Renderers that trace no such rays showed white molars in the corners of a dark mouth."""
REPLACES = {"teeth_upper_gums": "teeth_upper", "teeth_lower_gums": "teeth_lower", "tongue_body": "tongue"}
"""Meshes of the file, and the head's own part in place of which each stands."""

NECK, NECK_COLOUR = (0.62, 1.0), (0.10, 0.16, 0.26)
"""Places along a crown between which dentine shows through, and the share of red, green and blue that is lost there."""
EDGE, EDGE_COLOUR = 0.16, (0.16, 0.10, 0.04)
"""Length of the translucent biting edge along a crown, and the share lost at its end: the dark mouth shines through."""
BETWEEN = (0.50, 0.62, 0.66)
"""Share of red, green and blue that is lost deep between two teeth."""
MARGIN, MARGIN_LIGHT = 0.35, 0.25
"""Gums next to teeth are paler: how much, and the noise on gums, both as shares of their colour."""
GROOVE, PAPILLAE, UNDERSIDE = 0.22, 0.10, (1.0, 0.82, 0.86)
"""Depth of the median groove of the tongue and amplitude of its papillae as shares of the colour; factors on its
underside, whose thin mucosa is redder."""
ENAMEL_MM, MUCOSA_MM = (0.9, 0.75, 0.55), (2.2, 0.8, 0.5)
"""Mean free paths of red, green and blue in teeth, whose edges glow, and in the wet flesh of the mouth."""
ROOT = 0.35
"""Share of the tongue's light that is lost at its root, which is coated and lies in the throat."""


def mouth_parts(head: HeadModel, fit: Fit, tooth: Float32 | None, step: int = 1) -> tuple[MeshPart, ...]:
    """Teeth, gums and tongue; nothing for a head that they were not made for.

    ``tooth`` is the (3,) linear albedo of the teeth, None: the usual one. ``step`` divides the sides of pictures.
    """
    insets = read_insets()
    if not fits(insets, head):
        return ()
    rows = [mesh for mesh in insets.meshes if mesh.name.startswith("teeth")]
    tongue = next(mesh for mesh in insets.meshes if mesh.name.startswith("tongue"))
    crowns = teeth_picture(rows, TOOTH if tooth is None else tooth, SIZE // step)
    mucosa = OwnMap("tongue", tongue_picture(tongue, TONGUE_SIZE // step))
    enamel = Material(
        "teeth", colour_map=OwnMap("teeth", crowns), cavity_map=OwnMap("teeth_open", open_picture(rows)),
        roughness=0.18, ior=1.6, subsurface_mm=ENAMEL_MM,
    )  # fmt: skip
    flesh = Material("tongue", colour_map=mucosa, roughness=0.35, ior=1.4, subsurface_mm=MUCOSA_MM)
    sunk = np.array([0, -too_near(rows, fit.neutral - insets.fitted_head), 0])
    return tuple(
        following(
            mesh.name, head, fit, insets.fitted_head, mesh.rest, mesh.moved, mesh.faces, mesh.uv,
            flesh if mesh is tongue else enamel, uv_faces=mesh.uv_faces, lift=sunk * (mesh is rows[1]),
            bone="head" if mesh.name == "teeth_upper_gums" else "jaw", replaces=(REPLACES[mesh.name],),
        )
        for mesh in (*rows, tongue)
    )  # fmt: skip


def too_near(rows: list[Inset], offsets: AnyFloat) -> float:
    """Metres by which the lower of both rows is nearer to the upper one than in the mean head: in all but a twentieth.

    Features of a face move jaw and palate, each by itself, and rows that are carried along would cross. Offsets (V, 3)
    metres are those of the neutral head from the mean one.
    """
    upper, lower = rows
    above = Nearest(upper.rest[:, ::2]).one(lower.rest[:, ::2])[1]
    risen = lower.moved(offsets)[:, 1] - upper.moved(offsets)[above, 1]
    return max(float(np.quantile(risen, 0.95)), 0.0)


def teeth_picture(rows: list[Inset], tooth: Float32, size: int = SIZE) -> UInt8:
    """(size, size, 3) uint8 sRGB of the upper and lower row, of linear albedo (3,), on their common picture."""
    canvas = Canvas(size)
    for row in rows:
        at, values = canvas.texels(row.uv, row.uv_faces, row.faces, np.c_[row.along, row.shade, row.rest * 1e3])
        along, shade, place = values[:, 0], values[:, 1], values[:, 2:]
        neck = np.clip((along - NECK[0]) / (NECK[1] - NECK[0]), 0, 1)[:, None] ** 1.5
        edge = np.exp(-((np.maximum(along, 0) / EDGE) ** 2))[:, None]
        between = ((1 - np.clip(shade, 0, 1)) ** 1.5)[:, None]
        enamel = tooth * (1 - neck * np.array(NECK_COLOUR)) * (1 - edge * np.array(EDGE_COLOUR))
        enamel = enamel * (1 - between * np.array(BETWEEN))
        noise = smooth_noise(place, (0.5, 1.1, 2.4), seed=1)[:, None]
        gums = GUMS * (1 + MARGIN_LIGHT * noise) * (1 + MARGIN * np.clip(1 + along, 0, 1)[:, None])
        canvas.put(at, np.where(along[:, None] < 0, gums, enamel))
    return canvas.picture()


def open_picture(rows: list[Inset]) -> UInt8:
    """(OPEN_SIZE, OPEN_SIZE) uint8 linear: share of the sky that lips and cheeks leave to both rows of teeth."""
    canvas, front = Canvas(OPEN_SIZE), max(row.rest[:, 2].max() for row in rows)
    for row in rows:
        at, depth = canvas.texels(row.uv, row.uv_faces, row.faces, front - row.rest[:, 2:])
        canvas.put(at, shade(depth[:, 0], OPEN_M))
    return np.asarray(np.rint(255 * canvas.filled()[..., 0]), np.uint8)


def tongue_picture(tongue: Inset, size: int) -> UInt8:
    """(size, size, 3) uint8 sRGB of the tongue."""
    canvas = Canvas(size)
    at, values = canvas.texels(tongue.uv, tongue.uv_faces, tongue.faces, np.c_[tongue.along, tongue.rest * 1e3])
    along, place = values[:, 0], values[:, 1:]
    below = (at % size) >= size // 2
    groove = GROOVE * np.exp(-((place[:, 0] / 1.2) ** 2)) * np.clip(along * 4, 0, 1)
    papillae = PAPILLAE * smooth_noise(place, (4.5, 7.0, 11.0), seed=2)
    light = (1 - groove) * (1 + papillae) * (1 - ROOT * along**2)
    top = TONGUE * light[:, None]
    under = TONGUE * np.array(UNDERSIDE) * (1 - ROOT * along[:, None] ** 2)
    canvas.put(at, np.where(below[:, None], under, top))
    return canvas.picture()
