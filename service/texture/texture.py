"""The texture stage: the fitted photos of one head become the maps of a whole head.

Bald skin has the shadow of hair's roots where the photo shows hair, or the head would have it. It is pigment between
pores and no relief: it darkens the albedo when that is made, and the networks of normals never see it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from service.arrays import AnyFloat, Bool, Float32, Float64, UInt8
from service.colour import bytes_to_linear, linear_to_srgb, srgb_to_linear, to_bytes
from service.errors import NumericFault
from service.face.fit.fit import Fit
from service.face.reading.part_labels import BROW, HAIR, HAT, SKIN
from service.face.reading.reader import Reading, View
from service.geometry.chart import Chart
from service.geometry.mesh import laplacian, normalise, smooth_fit, splat, vertex_normals
from service.hair.worn_hair import WornHair
from service.head.regions import vertex_mask
from service.map_registry import MIRRORED, SEEN
from service.photo.photo import Photo
from service.robust import smoothstep
from service.texture.blending import Blend, Layer, blend
from service.texture.finer_cover import finer_cover, in_the_dark
from service.texture.inpainting import Completed, complete_skin
from service.texture.part_colours import Parts, brightest_cloth, paint_parts
from service.texture.unwrap import (
    Unwrapped,
    Zones,
    behind_glasses,
    covered,
    parts_at,
    parts_of_face,
    segment,
    shows_opening,
    unwrap,
    widened,
    worn_before,
)
from service.words import WarningCode


@dataclass(frozen=True)
class PhotoTexture:
    """What one of several photos shows, on the chart of the texture.

    Attributes:
        texture: (H, W, 3) uint8 sRGB in this photo's light; what it does not show is as the others do.
        lit_skin: (H, W) uint8, 255 where it shows skin on which the light can be measured.
        seen: (H, W) uint8, 255 where it shows the head's own surface.
        share: (H, W) uint8, 255 where the texture is this photo's alone.
        gain: (H, W, 3) float32, natural logarithm of linear RGB: of the texture's light over this photo's.
        white: (3,) linear RGB, ``Fit.eye_light`` of this photo; None: it does not tell.
        cloth: linear luminance of the brightest cloth in it; 0: none is seen.
    """

    texture: UInt8
    lit_skin: UInt8
    seen: UInt8
    share: UInt8
    gain: Float32
    white: Float64 | None = None
    cloth: float = 0.0


@dataclass(frozen=True)
class Texture:
    """Maps of the fitted head on its chart, (H, W) texels, row 0 = top (v = 1). All texels are filled, also outside the
    islands.

    Attributes:
        texture: (H, W, 3) uint8 sRGB, the photo's light baked in.
        bright: (H, W, 3) uint8, the same with all skin that is too dark in the photo for its colour to be told
            completed as where the photo shows none; None: there is none.
        confidence: (H, W) uint8: ``SEEN`` to 255 seen in the photo, ``MIRRORED`` to ``SEEN - 1`` mirrored from the
            other side, each by weight; 0 inpainted.
        lit_skin: (H, W) uint8, 255 where the texel is skin of the photo, seen or mirrored, so that the light can be
            measured on it; 0 where it is hair, glasses, background or inpainted.
        shape_normal_object: (H, W, 3) float32 unit normals of the head with the photo's expression, in head space.
        mask: (H, W) bool, True inside the islands.
        visible_fraction: share of the face region's area that the photo shows, in [0, 1].
        warnings: of what the photo does not show.
        parts: (H, W, 3) uint8 sRGB-coded diffuse albedo of eyes, eye sockets, teeth, tongue, mouth lining and lashes,
            extended over the chart; None for an external texture.
        iris, tooth: (3,) float32 linear RGB >= 0, albedo of irises and teeth; None for an external texture.
        roots: (H, W) uint8, 255 = 1: opacity of the shadow of hair roots; None: the hair stays on the skin.
        photos: what each of several photos shows, in the order of their fits; empty for one photo.
        cloth: linear luminance of the brightest cloth in the first photo; 0: none is seen.
    """

    texture: UInt8
    confidence: UInt8
    lit_skin: UInt8
    shape_normal_object: Float32
    mask: Bool
    visible_fraction: float
    warnings: tuple[WarningCode, ...] = field(default=())
    parts: UInt8 | None = None
    iris: Float32 | None = None
    tooth: Float32 | None = None
    roots: UInt8 | None = None
    photos: tuple[PhotoTexture, ...] = ()
    bright: UInt8 | None = None
    cloth: float = 0.0

    @property
    def legible(self) -> UInt8:
        """(H, W, 3) uint8 sRGB in the photo's light, what albedo is told from."""
        return self.texture if self.bright is None else self.bright

    @property
    def seen_by(self) -> UInt8 | None:
        """(H, W) uint8, how many of several photos show the texel; None: there is one photo."""
        return np.sum([one.seen > 127 for one in self.photos], 0, np.uint8) if self.photos else None


OVERALL_SMOOTHNESS = 12.0
"""Weight of the smoothness term that turns the head's normals into those of its overall form."""

LEAST_Z = 0.05
"""Smallest z of a tangent-space normal before normalisation. In folds (ears, lids) the surface can be turned by more
than a right angle from the overall form, which a tangent-space map cannot represent."""


def shape_normals(chart: Chart, vertices: AnyFloat) -> tuple[Float32, Float32]:
    """Unit normals (H, W, 3) float32 of a head (V, 3) in object space, and in the tangent space of its overall form.

    In the tangent frame of the surface itself, a smooth surface's normals are (0, 0, 1) everywhere. The frame is
    therefore that of normals smoothed over the mesh (``OVERALL_SMOOTHNESS``), so that the map shows nose, lips and
    eye sockets: +Y up, z >= ``LEAST_Z`` before normalisation.
    """
    normal = vertex_normals(vertices, chart.head.triangles)
    frame = chart.frame(vertices, overall_normals(chart, normal))
    exact = chart.normals(vertices)
    axes = (frame.tangent, frame.bitangent, frame.normal)
    local = np.stack([np.einsum("hwi,hwi->hw", exact, axis) for axis in axes], -1)
    local[..., 2] = np.maximum(local[..., 2], LEAST_Z)
    local /= np.sqrt(np.einsum("hwi,hwi->hw", local, local))[..., None]
    return chart.fill_outside(exact), chart.fill_outside(local)


def overall_normals(chart: Chart, normal: AnyFloat) -> Float64:
    """(V, 3) unit normals smoothed over the mesh; where opposite ones cancel, the original."""
    edges = laplacian(chart.head.triangles, len(normal))
    smooth = smooth_fit(edges, normal, np.ones(len(normal)), OVERALL_SMOOTHNESS, np.zeros(3), 1e-6)
    length = np.sqrt((smooth * smooth).sum(1, keepdims=True))
    return np.where(length > 0.05, normalise(smooth), normal)


def depth_map(chart: Chart, vertices: AnyFloat) -> Float32:
    """(H, W) float32 metres: z of each texel in head space, extended beyond the islands."""
    return chart.fill_outside(chart.interpolate(np.asarray(vertices)[:, 2])[..., 0])


SMOOTHNESS = 0.5
PRIOR_TRUST = 0.01
"""Weights of the density's smoothness and of what is expected where no scalp is seen, relative to a seen texel."""


def root_shadow(chart: Chart, parts: Float32 | None, weight: Float32, zones: Zones) -> Float32:
    """(N,) float32 opacity in [0, 1] of the shadow at the inner texels.

    Args:
        chart: of the head; all is 0 without a region "scalp".
        parts: (N, 13) as ``service.texture.unwrap.parts_at`` gives them; None: nothing was read.
        weight: (N,) of the photo at the texels, before anything was found to hide them.
        zones: of the same texels.
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
        edges = laplacian(head.skin_triangles, count)
        density = np.clip(smooth_fit(edges, known, trust, SMOOTHNESS, prior, PRIOR_TRUST), 0, 1)
    # Values of the scalp's soft mask between which hair begins.
    grown = chart.inside(density.astype(np.float32))[:, 0] * smoothstep(zones.scalp, 0.15, 0.85) * zones.skin
    # Of the shadow where hair grows densely: skin between roots shows as much again.
    return np.asarray(0.5 * grown, np.float32)


def left_by_roots(texture: Texture, hair: WornHair) -> UInt8 | None:
    """(H, W, 3) uint8, linear, 255 = 1: what the shadow of a hair's roots leaves of the skin; None: all of it."""
    if texture.roots is None:
        return None
    # Colour of roots over the mean of the hair's strands: no light gets between them.
    root = np.clip(hair.root_colour * np.float32(0.8), 0, 1)
    left = np.minimum(root / np.maximum(bytes_to_linear(texture.legible), np.float32(1e-3)), 1)  # never lighter
    return to_bytes(1 + texture.roots[..., None] * np.float32(1 / 255) * (left - 1))


DEFAULT_SKIN = np.array([0.75, 0.59, 0.51], np.float32)
"""Skin colour for a photo that shows no skin, sRGB."""


@dataclass(frozen=True)
class Shown:
    """What one photo shows of a head, whatever hair it will wear, at the inner texels (N,).

    Attributes:
        unwrapped: the photo on them.
        parts: (N, 13) float32 probabilities.
        strands, glasses, black: (N,) float32 in [0, 1], how far strands, glasses and blackness hide the head.
        dark: (N,) float32 in [0, 1], how far darkness hides its colour.
        cloth: linear luminance of the brightest cloth; 0: none is seen.
    """

    unwrapped: Unwrapped
    parts: Float32
    strands: Float32
    glasses: Float32
    black: Float32
    dark: Float32
    cloth: float = 0.0

    @classmethod
    def of(cls, chart: Chart, zones: Zones, photo: Photo, fit: Fit, reading: Reading | None) -> Shown:
        """A photo and its reading; where nothing was read, nothing is known to hide the head."""
        unwrapped = unwrap(photo, fit, chart)
        if reading is None:
            nothing = np.zeros_like(unwrapped.weight)
            return cls(unwrapped, parts_of_face(chart, unwrapped, zones), nothing, nothing, nothing, nothing)
        parts = parts_at(reading, fit, unwrapped)
        read = chart, unwrapped, parts, zones
        dark, black = in_the_dark(*read)
        black = np.maximum(black, dark * (1 - zones.face))  # what is dark beside the face may be a collar
        strands, rims = finer_cover(*read)
        hidden = strands, behind_glasses(chart, unwrapped, parts, rims), black, dark
        return cls(unwrapped, parts, *hidden, brightest_cloth(photo, reading))


@dataclass(frozen=True)
class Unwrappings:
    """What photos show of one head, whatever hair it will wear.

    Attributes:
        zones: of the inner texels (N,).
        sights: of each photo.
        normals: (H, W, 3) float32 unit, of the head in head space, continued beyond the islands.
    """

    zones: Zones
    sights: tuple[Shown, ...]
    normals: Float32

    @classmethod
    def of(cls, chart: Chart, views: Sequence[tuple[Photo, Fit, Reading | None]]) -> Unwrappings:
        """Unwrap photos, each with its own fit of the head, the first with that of the texture."""
        zones, vertices = Zones.of(chart), views[0][1].vertices
        sights = tuple(Shown.of(chart, zones, *view) for view in views)
        return cls(zones, sights, chart.fill_outside(chart.normals(vertices)))


def make_texture(
    photo: Photo, fit: Fit, chart: Chart, reading: Reading | None = None,
    bald: bool = False, others: Sequence[tuple[View, Fit]] = (), known: Unwrappings | None = None,
) -> Texture:  # fmt: skip
    """Unwrap photos on the fitted head, blend them and inpaint the rest.

    Args:
        photo: the upright photo that was fitted; of several the one whose light, eyes and mouth the texture has.
        fit: camera and vertices of the head that ``chart`` was built from.
        chart: gives the size of the maps, 576 x 384 for AvatarMe's texture.
        reading: says what the photo shows of the head; without one its face is taken from the photo and nothing else,
            and the warning is ``not-segmented``.
        bald: hair is worn as a mesh, and the skin beneath is bald, with the shadow of the roots; else the photo's hair
            stays on the scalp, as on a shaved head.
        others: further photos of the person, and the same head's fits in them.
        known: of these photos; None: it is made.

    Raises:
        NumericFault: a map is not finite.
    """
    views = [(photo, fit, reading), *((view.photo, other, view.reading) for view, other in others)]
    known = known or Unwrappings.of(chart, views)
    zones = known.zones

    def made(telling: bool) -> tuple[list[Layer], Blend, Completed, Parts]:
        """What photos show, mixed and completed, with eyes and mouth; ``telling``: what tells no colour, too."""
        layers = [_layer(chart, zones, one, bald=bald, telling=telling) for one in known.sights]
        mixed = blend(chart, layers, [one for _, one, _ in views], zones)
        unwrapped, part, found = mixed.layer.unwrapped, mixed.layer.parts, mixed.layer.found
        fallback = DEFAULT_SKIN if found.colour is None else found.colour
        given = chart, unwrapped.colour, found.seen, fallback
        completed = complete_skin(*given, plain=1 - part[:, BROW], worn=part[:, HAT])
        person, sure = fallback if fit.cheek is None else fit.cheek, _confidence(completed)
        shown = chart, fit, unwrapped, zones, found.face, part, completed.colour, sure, person
        return layers, mixed, completed, paint_parts(*shown)

    layers, mixed, completed, parts = made(telling=True)
    unwrapped, part, weight, found = mixed.layer.unwrapped, mixed.layer.parts, mixed.layer.weight, mixed.layer.found
    texture, bright = chart.fill_outside(chart.spread(parts.colour)), None
    if any((one.dark > 0.5).any() for one in known.sights):
        texture, bright = chart.fill_outside(chart.spread(made(telling=False)[-1].colour)), to_bytes(texture)
    roots = None
    if bald:
        shadow = root_shadow(chart, None if reading is None else part, weight, zones)
        roots = to_bytes(chart.fill_outside(chart.spread(shadow[:, None])[..., 0]))

    for name, values in (("texture", texture), ("normals", known.normals)):
        if not np.isfinite(values).all():
            raise NumericFault(f"the {name} map has {int((~np.isfinite(values)).sum())} values that are not finite")
    fraction = visible_fraction(chart, fit, unwrapped, zones)
    code = chart.fill_outside(chart.spread(parts.code[:, None])[..., 0]).astype(np.uint8)
    maps = chart.spread(np.stack([completed.seen, completed.from_mirror, found.lit], 1))
    direct, reflected, lit_map = np.moveaxis(maps, 2, 0)
    shown = np.rint(255 * np.clip(direct * lit_map + reflected * lit_map[:, ::-1], 0, 1))
    shown = chart.fill_outside(shown).astype(np.uint8)
    # Visible fraction of the face below which a warning is given.
    doubts: dict[WarningCode, bool] = {"little-seen": fraction < 0.25, "not-segmented": reading is None}
    warnings = tuple(name for name, true in doubts.items() if true)
    warnings += () if reading is None else worn_before(part, weight, zones)
    return Texture(
        to_bytes(texture), code, shown, known.normals, chart.mask, fraction, warnings,
        to_bytes(parts.albedo), parts.iris, parts.tooth, roots,
        _per_photo(chart, known, layers, mixed, parts.colour, [one for _, one, _ in views]) if others else (), bright,
        known.sights[0].cloth,
    )  # fmt: skip


def _layer(chart: Chart, zones: Zones, shown: Shown, *, bald: bool, telling: bool) -> Layer:
    """What one photo shows of the head; ``telling``: what tells no colour is hidden, too."""
    unwrapped, parts, weight = shown.unwrapped, shown.parts, shown.unwrapped.weight
    # On the scalp of a head that wears no mesh, hair is the head's own however far it is followed.
    strands = shown.strands if bald else shown.strands * (1 - zones.scalp)
    hidden = np.maximum.reduce([covered(parts, zones, bald=bald), strands, shown.black])
    if telling:
        hidden = np.maximum(hidden, shown.dark)
    if bald:
        hidden = widened(chart, hidden)
    hidden = np.maximum.reduce([hidden, shown.glasses, shows_opening(parts, zones)])
    bare: Bool = np.asarray(unwrapped.visible & (hidden < 0.5))
    unwrapped = replace(unwrapped, weight=weight * (1 - hidden), visible=bare)
    return Layer(unwrapped, parts, weight, segment(chart, unwrapped, parts, zones))


def _per_photo(
    chart: Chart, known: Unwrappings, layers: Sequence[Layer], mixed: Blend, colour: Float32, fits: Sequence[Fit]
) -> tuple[PhotoTexture, ...]:
    """What each of several photos shows, what it does not shown as by the others in its light."""
    linear = srgb_to_linear(np.clip(colour, 0, 1))
    found = []
    for sight, layer, share, gain, fit in zip(known.sights, layers, mixed.shares, mixed.gains, fits, strict=True):
        seen = (layer.found.seen * (layer.unwrapped.weight > 0))[:, None]
        elsewhere = linear_to_srgb(np.clip(linear * np.exp(-gain), 0, 1))
        own = elsewhere + seen * (layer.unwrapped.colour - elsewhere)
        planes = np.concatenate([own, layer.found.lit[:, None] * seen, seen, share[:, None]], 1)
        image = to_bytes(np.clip(chart.fill_outside(chart.spread(planes)), 0, 1))
        field = chart.fill_outside(chart.spread(gain))
        lit, shown, part = np.moveaxis(image[..., 3:], 2, 0).copy()
        found.append(PhotoTexture(image[..., :3].copy(), lit, shown, part, field, fit.eye_light, sight.cloth))
    return tuple(found)


def _confidence(completed: Completed) -> Float32:
    """(N,) confidence code of each texel, see ``service.texture.texture``."""
    seen = np.rint(SEEN + (255 - SEEN) * completed.seen)
    reflected = np.rint(MIRRORED + (SEEN - 1 - MIRRORED) * completed.from_mirror)
    inpainted = 1 - completed.seen - completed.from_mirror
    code = np.where(completed.from_mirror > np.maximum(inpainted, completed.seen), reflected, 0)
    return np.asarray(np.where(completed.seen >= np.maximum(completed.from_mirror, inpainted), seen, code), np.float32)


def visible_fraction(chart: Chart, fit: Fit, unwrapped: Unwrapped, zones: Zones) -> float:
    """Share of the face region's area, in [0, 1], that faces the camera and is not occluded."""
    e, f, g = chart.metric(fit.vertices).reshape(-1, 3)[chart.texels].T
    area = np.sqrt(np.maximum(e * g - f * f, 0)) * zones.face * zones.skin
    total = float(area.sum())
    return float(area[unwrapped.visible].sum() / total) if total > 0 else 0.0
