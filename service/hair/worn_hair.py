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
from service.hair.colour import DYED, KNOTS, NEUTRAL, as_absorbed, farther_if_black, is_warm
from service.hair.groom import Groom
from service.hair.scalp import CENTRE, Scalp
from service.levels import QualityName
from service.light.formulas import sh_basis
from service.materials.material import Material, OwnMap
from service.materials.part import MeshPart
from service.render.sketch import MIRRORED, with_gloss, without_gloss
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
    hair: WornHair, parts: tuple[MeshPart, ...], light: Float32
) -> tuple[WornHair, tuple[MeshPart, ...]]:
    """Hair and its meshes without the photo's light, in a colour that melanin has, or dye where it is far from those.

    Args:
        hair: of the photo.
        parts: with those of :func:`hair_cards`; all others stay as they are.
        light: (3,) factors from colours in the photo's light on hair to albedo.
    """
    if hair.groom is None or not hair.in_photo_light or not len(hair.groom):
        return hair, parts
    groom, unlit = groom_in_albedo(hair.groom, parts, light)
    return replace(hair, groom=groom, in_photo_light=False), unlit


def groom_in_albedo(
    groom: Groom, parts: tuple[MeshPart, ...], light: Float32, name: str = HAIR
) -> tuple[Groom, tuple[MeshPart, ...]]:
    """As :func:`hair_in_albedo`, of strands, at least one, whose meshes have names that begin with ``name``."""
    seen = groom.colour.linear()
    usual = np.median(seen.reshape(-1, 3), 0)
    brown = is_warm(usual) or is_warm(usual * light)
    if is_warm(usual):
        light = _as_coloured(light, usual)
    white = np.clip(seen * light, 1e-3, 0.9)
    middle = np.clip(usual * light, 1e-3, 0.9)
    # Strands that are brighter than the rest mirror more than the rest.
    beside = np.clip(luma(white) / luma(middle), *MIRRORS)[..., None]
    # Of hair that has a hue no more than is drawn again: that of black hair is what it mirrors.
    hued = brown and middle.min() < (1 - NEUTRAL) * middle.max()
    own = without_gloss(white, (min(mirrored(middle), MIRRORED) if hued else mirrored(middle)) * beside)
    if brown:  # nor is a strand that the light blew out
        own = np.minimum.accumulate(own, -1)
    grey = greyed(np.median(own.reshape(-1, 3), 0))
    if grey or brown:
        doubt = grey_doubt(light) if grey else HUE_DOUBT
        own = (1 - doubt) * own + doubt * as_absorbed(own, dyed_from=np.inf, redder=not grey).linear(KNOTS)
        unlit_colour = as_absorbed(own, dyed_from=0.0)
    else:
        # What is black in the photo is not dyed, however little light it is told to have had.
        unlit_colour = as_absorbed(own, dyed_from=DYED + farther_if_black(float(luma(usual))), redder=True)
    made = replace(unlit_colour, measured=groom.colour.measured)
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


def _as_coloured(light: Float32, usual: Float32) -> Float32:
    """Factors (3,) as bright as ``light`` and no more coloured than leaves brown hair (3,) without a hue.

    Hair that is brown in the photo is neither green nor violet without its light: a hue that no melanin has is the
    light's, which need not be as coloured on the hair as on the face.
    """
    shares = [1.0]
    for more, less in ((0, 1), (1, 2)):
        turns = np.log(light[less] / light[more])
        if turns > 0:
            shares.append(float(np.log(usual[more] / max(float(usual[less]), 1e-6)) / turns))
    made = light ** min(shares)
    return np.asarray(made * luma(usual * light) / max(float(luma(usual * made)), 1e-6), np.float32)


HUE = 0.2
"""Standard deviation of the logarithm of a channel of hair beside that of the melanin nearest to it."""
AMOUNTS = MIRRORED * 2 ** np.linspace(-2, 3.5, 23, dtype=np.float32)
MIRRORS = 0.3, 4.0
"""Least and most that a strand mirrors over the usual one."""


def mirrored(colour: Float32) -> float:
    """How much white light hair mirrors that has a linear RGB (3,) under white light.

    The likeliest of ``AMOUNTS``, which vary by a factor of two: dark hair without a hue is black and shines, as no
    melanin is grey.
    """
    if greyed(without_gloss(colour, MIRRORED)):
        return MIRRORED  # it is grey itself, and tells nothing
    inside = [without_gloss(colour, float(amount)) for amount in AMOUNTS]
    nearest = as_absorbed(np.repeat(np.array(inside)[:, None], KNOTS, 1), dyed_from=np.inf).linear()[:, 0]
    off = [np.log(with_gloss(one, float(amount)) / colour) for one, amount in zip(nearest, AMOUNTS, strict=True)]
    cost = np.square(np.array(off) / HUE).sum(1) + np.square(np.log2(AMOUNTS / MIRRORED))
    return float(AMOUNTS[int(cost.argmin())])


GREYED = (0.06, 0.1), NEUTRAL
"""Luminances from which on hair without any hue is grey, and hair of the saturation, 1 - min / max, up to which it is:
brown as fair as the latter has 0.75, and blond 0.6."""


def greyed(albedo: Float32) -> bool:
    """Whether hair of a linear albedo (3,) is grey: it has the colour of melanin, and of strands that have lost it."""
    (none, most), saturation = GREYED
    hue = (1 - albedo.min() / max(float(albedo.max()), 1e-6)) / saturation
    return bool(hue < 1 and luma(albedo) > none + (most - none) * hue)


HUE_DOUBT = 0.5
"""Share of the hue of brown hair, where it is none that melanin has, that is the photo's light or what it mirrors: real
hair lies about melanin's colours as far as these are told."""
LIGHT_HUE, HAIR_HUE = (0.1, 0.35), 0.35
"""Standard deviation of the logarithm of red over blue: of white light as it is told, and what it grows by with that
logarithm of coloured light; and of hair about melanin of its brightness."""


def grey_doubt(light: Float32) -> float:
    """How likely hair that is grey without a light (3,) is blond, in [0, 1]: coloured light is told less surely."""
    told = LIGHT_HUE[0] + LIGHT_HUE[1] * float(np.log(light.max() / max(float(light.min()), 1e-6)))
    return told**2 / (told**2 + HAIR_HUE**2)


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
