"""All that an avatar wears: hair, lashes, brows and bust, in its albedo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.anatomy.hair.bust import bust_part
from service.anatomy.hair.colour import as_melanin
from service.anatomy.hair.find import Hair
from service.anatomy.hair.parts import brow_part, hair_part, lash_part
from service.arrays import Float32, UInt8, UInt16
from service.colour import bytes_to_linear
from service.face.fit.result import Fit
from service.head.model import HeadModel
from service.materials.part import MeshPart

LIT = 200
"""Code of the lit skin's map from which on a texel tells what the photo's light is."""
LEAST_TEXELS = 100
"""Fewest such texels."""
RANGE = (0.2, 4.0)
"""Smallest and largest ratio of albedo to the photo's colour in a channel."""


def worn(
    hair: Hair, head: HeadModel, fit: Fit, texture: UInt8, lit_skin: UInt8, albedo: UInt16 | None, *, brows: bool
) -> tuple[MeshPart, ...]:
    """Meshes beside the head's own.

    Args:
        hair: of the photo.
        head: topology, chart and units.
        fit: vertices of the head.
        texture: (h, w, 3) uint8 sRGB on the chart, in the photo's light.
        lit_skin: (h, w) uint8, 255 where the texture shows lit skin.
        albedo: (H, W, 3) uint16 sRGB-coded; None: all colours stay in the photo's light, as the texture does.
        brows: whether brows are cards too.
    """
    small = None if albedo is None else _small(albedo, texture.shape)
    light = np.ones(3, np.float32)
    if small is not None:
        light = to_albedo(texture, small, lit_skin)
        brow = None if hair.brow_colour is None else as_melanin(hair.brow_colour * light) / light
        hair = replace(hair, colour=hair.colour.natural(light), brow_colour=brow)
    parts = (
        bust_part(head, fit, texture if small is None else small),
        hair_part(hair, head, fit, light),
        brow_part(hair, head, fit, light) if brows else None,
        lash_part(head, fit),
    )
    return tuple(part for part in parts if part is not None)


def to_albedo(texture: UInt8, albedo: UInt8, lit_skin: UInt8) -> Float32:
    """(3,) median ratio of linear albedo to linear texture, both (h, w, 3) uint8, over lit skin (h, w); 1 without any.

    The light on hair is that on the skin: the networks say what it is there.
    """
    chosen = lit_skin >= LIT
    if int(chosen.sum()) < LEAST_TEXELS:
        return np.ones(3, np.float32)
    shown, own = (bytes_to_linear(image[chosen]) for image in (texture, albedo))
    ratio = np.median(own / np.maximum(shown, np.float32(1e-3)), 0)
    return np.asarray(np.clip(ratio, *RANGE), np.float32)


def _small(albedo: UInt16, shape: tuple[int, ...]) -> UInt8:
    import cv2

    small = np.asarray(cv2.resize(albedo, (shape[1], shape[0]), interpolation=cv2.INTER_AREA), np.float32)
    return np.rint(small / 257).astype(np.uint8)
