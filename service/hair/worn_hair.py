"""What hair a head wears: strands in their colour, how sure that is, and what of it goes into files and pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from service.arrays import Float32, UInt8
from service.colour import bytes_to_linear, linear_to_srgb, luma
from service.face.fit.fit import Fit
from service.geometry.mesh import unit
from service.hair.cards import BUDGETS, HAIR, hair_parts
from service.hair.colour import KNOTS, SURFACE, as_absorbed
from service.hair.groom import Groom
from service.hair.pigment import TURNED, told_pigment
from service.hair.scalp import CENTRE, Scalp
from service.levels import QualityName
from service.light.formulas import sh_basis
from service.materials.material import Material, OwnMap
from service.materials.part import MeshPart
from service.words import WarningCode


@dataclass(frozen=True)
class WornHair:
    """Hair of one photo: what the stage "hair" hands on.

    Attributes:
        groom: strands on the fitted head at rest, in their colour; None on a head that wears none.
        kind: what one would call it, a key of ``kinds`` or, where it was asked for, the name of a style.
        kinds: probability of each kind in [0, 1], sum 1; empty where nothing was read.
        seen: (N,) float32 in [0, 1], share of each strand that the photo shows; the rest is a likely one.
        agreement: intersection over union of its silhouette and the photo's hair, in [0, 1]; 0 where none was compared.
        doubts: stable codes for the manifest; docs/hair.md lists them.
        in_photo_light: whether the colour of the strands still has the photo's light in it.
    """

    groom: Groom | None
    kind: str
    kinds: dict[str, float]
    seen: Float32
    agreement: float = 0.0
    doubts: tuple[WarningCode, ...] = ()
    in_photo_light: bool = False

    @property
    def root_colour(self) -> Float32:
        """(3,) float32 linear RGB, the usual colour at the roots; dark brown without strands."""
        if self.groom is None or not len(self.groom):
            return np.array([0.05, 0.03, 0.02], np.float32)
        return np.asarray(np.median(self.groom.colour.linear()[:, 0], 0), np.float32)


def hair_cards(hair: WornHair, skin: Scalp | None, quality: QualityName, seed: int) -> tuple[MeshPart, ...]:
    """Meshes of the hair, in the light that its colour has; none on a head that wears no strands.

    Args:
        hair: of the photo.
        skin: of the fitted head at rest; None where hair grows nowhere.
        quality: says how many triangles and texels.
        seed: of all that is random.
    """
    return () if hair.groom is None or skin is None else hair_parts(hair.groom, skin, BUDGETS[quality], seed)


TURNED_IF_BEARD_IS = 0.65, 0.03
"""Probability that hair is turning grey where the beard does and where it does not: beards turn first."""
BESIDE = 0.2, 5.0
"""Least and most that a strand is as bright as the usual one."""
RETURNED = 0.9
"""What strands show of their colour where a surface beside them shows all of its own, as they shade each other: 1.0
under a clouded sky to 0.6 below a flash, in our own renderer."""


def over_skin(groom: Groom | None, fit: Fit) -> float:
    """How bright hair of a colour is in the photo over skin of the same: the light from above is on more of it."""
    if fit.light is None or groom is None or not len(groom):
        return 1.0
    points = groom.strands[:, ::4].reshape(-1, 3)
    normals = unit(points - CENTRE) @ fit.camera.rotation.T
    facing = np.where(points[:, 1] > 0, np.maximum(-normals[:, 2], 0), 0)  # above the eyes it lies on the skull
    arrives = luma(np.asarray(sh_basis(normals) @ fit.light, np.float32))
    # The light was read off the face; on the hair it is told by extension.
    return RETURNED * float(np.clip((facing * arrives).sum() / max(float(facing.sum()), 1e-6), 0.5, 2.0))


def hair_in_albedo(
    hair: WornHair, parts: tuple[MeshPart, ...], light: Float32, beard: Groom | None = None
) -> tuple[WornHair, tuple[MeshPart, ...]]:
    """Hair and its meshes without the photo's light, in a colour that melanin has, or dye where it is far from those.

    Args:
        hair: of the photo.
        parts: with those of :func:`hair_cards`; all others stay as they are.
        light: (3,) factors from colours in the photo's light on hair to albedo.
        beard: in the photo's light; None without one. Who has a grey one is likely to be grey.
    """
    if hair.groom is None or not hair.in_photo_light or not len(hair.groom):
        return hair, parts
    turned = TURNED
    if beard is not None and len(beard):
        grey = told_pigment(_usual(beard), light).grey
        turned = grey * TURNED_IF_BEARD_IS[0] + (1 - grey) * TURNED_IF_BEARD_IS[1]
    groom, unlit = groom_in_albedo(hair.groom, parts, light, turned=turned)
    return replace(hair, groom=groom, in_photo_light=False), unlit


def groom_in_albedo(
    groom: Groom, parts: tuple[MeshPart, ...], light: Float32, name: str = HAIR, turned: float = TURNED
) -> tuple[Groom, tuple[MeshPart, ...]]:
    """As :func:`hair_in_albedo`, of strands, at least one, whose meshes have names that begin with ``name``."""
    seen, usual = groom.colour.linear(), _usual(groom)
    pigment = told_pigment(usual, light, turned)
    # Strands are as bright beside each other as in the photo, by more or less of the same pigment.
    bright = luma(pigment.albedo) * np.clip(luma(seen) / max(float(luma(usual)), 1e-4), *BESIDE)
    colour = as_absorbed(np.broadcast_to(pigment.albedo, (1, KNOTS, 3)), dyed_from=0.0)
    made = replace(colour.as_bright(np.clip(bright, 1.5 * SURFACE, 0.9)), measured=groom.colour.measured)
    change = _changes(seen, made.linear(KNOTS))
    # Materials and textures that parts share stay shared.
    materials: dict[str, Material] = {}
    pictures: dict[int, OwnMap] = {}
    for part in parts:
        one = part.material.colour_map
        if part.name.split("_")[0] == name and isinstance(one, OwnMap):
            if id(one) not in pictures:
                pictures[id(one)] = _recoloured(one, change)
            materials[part.material.name] = replace(part.material, colour_map=pictures[id(one)])
    unlit = tuple(replace(part, material=materials.get(part.material.name, part.material)) for part in parts)
    return replace(groom, colour=made), unlit


def _usual(groom: Groom) -> Float32:
    """(3,) linear RGB, the usual colour of its strands."""
    return np.asarray(np.median(groom.colour.linear().reshape(-1, 3), 0), np.float32)


LEVELS_OF_HAIR = 16
"""Brightnesses at which a hair's change of colour is told: bright strands mirror the sky, dark ones do not."""


def _changes(before: Float32, after: Float32) -> Float32:
    """(256, 3) factors on linear colours of hair by its coded grey, from strands (N, K, 3) before and after."""
    old, new = before.reshape(-1, 3), after.reshape(-1, 3)
    grey = 255 * cv2.cvtColor(linear_to_srgb(old)[None], cv2.COLOR_RGB2GRAY)[0]
    groups = [group for group in np.array_split(np.argsort(grey, kind="stable"), LEVELS_OF_HAIR) if len(group)]
    levels = np.array([np.median(grey[group]) for group in groups])
    factors = np.array([np.median(new[one], 0) / np.maximum(np.median(old[one], 0), 1e-5) for one in groups])
    codes = np.arange(256)
    return np.stack([np.interp(codes, levels, column) for column in factors.T], 1).astype(np.float32)


def _recoloured(picture: OwnMap, change: Float32) -> OwnMap:
    """The picture with its colours times factors (256, 3), linear, by their coded grey."""
    linear = bytes_to_linear(np.arange(256, dtype=np.uint8))[:, None, None] * change
    coded: UInt8 = np.rint(255 * linear_to_srgb(np.clip(linear, 0, 1).astype(np.float32))).astype(np.uint8)
    grey = cv2.cvtColor(np.ascontiguousarray(picture.pixels[..., :3]), cv2.COLOR_RGB2GRAY)
    planes = [coded[picture.pixels[..., k], grey, k] for k in range(3)]
    return OwnMap(picture.name, np.dstack([*planes, picture.pixels[..., 3:]]))
