"""Hair, lashes, brows and bust of one head as meshes for files and pictures."""

from __future__ import annotations

import numpy as np

from service.anatomy.hair.find import Hair
from service.anatomy.hair.item import Item, Items, read_items
from service.anatomy.hair.picture import hair_picture
from service.anatomy.hair.skull import Skull, fits, hair_on, mirrored
from service.anatomy.hair.tailored import Tailored
from service.arrays import AnyFloat, Float32, Int32, UInt8
from service.colour import linear_to_srgb
from service.face.fit.result import Fit
from service.geometry.normals import area_normals, face_normals
from service.head.model import HeadModel
from service.materials.material import Material, OwnMap
from service.materials.part import MeshPart, targets_of

LASHES = "lash/eyelashes02"
"""Upper and lower lashes of every head: even, of middle length."""
LASH = np.array([0.0143, 0.0092, 0.0077], np.float32)
"""Diffuse albedo of lashes, linear RGB."""
LASH_DENSITY = 0.5
"""Factor on the asset's alpha, half of which is covered: 120 lashes of 0.07 mm, which taper, cover a quarter of a lid's
30 mm (Thibaut et al. 2010). Denser ones shade the eye in path tracers."""

BROW_LIFT_M = 0.0004
"""Height of the brows' cards over where they were made: the skin of another head is curved differently."""
HAIR_IOR = 1.55
"""Of human hair (Marschner et al. 2003, table 1)."""
ROUGHNESS = (0.36, 0.5)
"""Of glossy and of dull hair, across strands."""
CUTOFF = 0.35
"""Alpha below which a texel of hair is cut off: under one half, as mip levels thin out cards."""


def hair_part(hair: Hair, head: HeadModel, fit: Fit, light: Float32) -> MeshPart | None:
    """The style as a mesh that stands still; None for a bald head.

    Args:
        hair: as :func:`service.anatomy.hair.find.find_hair` gives it.
        head: topology of the head.
        fit: its vertices.
        light: (3,) factors from colours in the photo's light to albedo.
    """
    if hair.choice.name is None:
        return None
    items, cut = read_items(), hair.choice.cut
    item = items.items[hair.choice.name]
    skull = Skull.of(head, fit.neutral)
    made = hair.tailored
    if made is None:
        worn = mirrored(item, head) if cut.mirrored else item
        made = Tailored(hair_on(item, items, skull, cut), worn.uv, worn.triangles, None, 0.0)
    picture = OwnMap("hair", hair_picture(item, hair.colour, light))
    # Highlights of glossy hair are narrower.
    roughness = float(np.clip(ROUGHNESS[1] - 0.1 * (hair.colour.sheen - 1.0), *ROUGHNESS))
    material = Material(
        "hair", colour_map=picture, alpha="mask", cutoff=CUTOFF, double_sided=True, roughness=round(roughness, 3),
        ior=HAIR_IOR,
    )  # fmt: skip
    faces = outwards(made.points, made.triangles, skull)
    return MeshPart("hair", made.points, made.points, faces, made.uv, material)


def outwards(points: Float32, triangles: Int32, skull: Skull) -> Int32:
    """(T, 3) triangles of cards from the skin outwards, for viewers that blend them in the order of the file.

    All face outwards: a normal on the other side of a face than its front would be turned round by path tracers.
    """
    middle = points[triangles].mean(1)
    _, away, normal = skull.nearest(middle)
    inward = (face_normals(points, triangles) * normal).sum(1) < 0
    wound = np.where(inward[:, None], triangles[:, ::-1], triangles)
    return np.ascontiguousarray(wound[np.argsort(away, kind="stable")], np.int32)


def lash_part(head: HeadModel, fit: Fit) -> MeshPart | None:
    """Upper and lower lashes, which follow the lids; None for a head that they were not made for."""
    items = read_items()
    if not fits(items, head):
        return None
    colour = np.rint(255 * linear_to_srgb(LASH)).astype(np.uint8)
    alpha = np.rint(LASH_DENSITY * items.items[LASHES].picture[..., 0]).astype(np.uint8)
    material = Material(
        "lashes", colour_map=OwnMap("lashes", _in_colour(alpha, colour)), alpha="blend", double_sided=True,
        roughness=0.6,
    )  # fmt: skip
    return following("lash_cards", items.items[LASHES], items, head, fit, material, ("lashes",))


def _in_colour(alpha: UInt8, colour: UInt8) -> UInt8:
    """(h, w, 4) one sRGB colour (3,) with an alpha (h, w)."""
    flat = np.broadcast_to(colour, (*alpha.shape, 3))
    return np.ascontiguousarray(np.concatenate([flat, alpha[..., None]], 2))


def following(
    name: str, item: Item, items: Items, head: HeadModel, fit: Fit, material: Material, replaces: tuple[str, ...] = (),
    lift: AnyFloat | float = 0.0,
) -> MeshPart:  # fmt: skip
    """An item that follows identity and expression.

    Args:
        name: of the part.
        item: what.
        items: the file that it is from.
        head: topology and units.
        fit: vertices of the head.
        material: its surface.
        replaces: parts of the head in whose place it stands.
        lift: (N, 3) metres that its vertices are moved by.
    """
    return MeshPart(
        name,
        np.asarray(item.worn(fit.vertices - items.fitted_head) + lift, np.float32),
        np.asarray(item.worn(fit.neutral - items.fitted_head) + lift, np.float32),
        item.triangles,
        item.uv,
        material,
        targets=targets_of(head, item.moved),
        replaces=replaces,
    )


def brow_part(hair: Hair, head: HeadModel, fit: Fit, light: Float32) -> MeshPart | None:
    """Brows over those of the skin, in the shape that agrees best with the photo's; None where none was compared.

    Args:
        hair: with the brows' shape and colour.
        head: topology and units.
        fit: vertices of the head.
        light: (3,) factors from colours in the photo's light to albedo.
    """
    items = read_items()
    if hair.brow is None or hair.brow_colour is None or not fits(items, head):
        return None
    item = items.items[hair.brow]
    coded = linear_to_srgb(np.clip(hair.brow_colour * light, 0, 0.6).astype(np.float32))
    picture = _in_colour(item.picture[..., 0], np.rint(255 * coded).astype(np.uint8))
    material = Material("brows", colour_map=OwnMap("brows", picture), alpha="blend", double_sided=True, roughness=0.6)
    normals = area_normals(item.worn(fit.neutral - items.fitted_head), item.triangles)
    return following("brow_cards", item, items, head, fit, material, lift=BROW_LIFT_M * normals)
