"""The surface of an avatar as maps at the resolution of a picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from service.arrays import AnyFloat, Float32, UInt8
from service.colour import bytes_to_linear
from service.errors import BadArchive
from service.geometry.chart import NO_PART, Chart
from service.head.model import HeadModel
from service.image_filters import resized
from service.light.samples import LitChart
from service.materials.part import SKIN

Size = tuple[int, int]

ROLES = ("diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal", "roughness", "texture")
"""Maps that a render uses; the texture only where there is no albedo."""

SPECULAR = 0.65
"""Specular albedo where there is no map: F0 = 0.026, between water and dry skin."""

LOBES = (0.25, 0.48, 0.75)
"""Skin: GGX alpha of both lobes and weight of the first, the middle of the light stage's ranges. The map of roughness,
where there is one, says how much smoother lips and nose are."""

LARGEST = 3072
"""Widest chart that is lit; a picture of 4096 pixels resolves no more of a head."""

_BAND = 64
"""Rows of the reduced map computed at once."""
_DENSEST = 12.0
"""Most texels per mm for which the scattering network is exported."""


@dataclass(frozen=True)
class StoredMap:
    """A map of an avatar, still encoded.

    Attributes:
        codes: decodes it: (H, W, 3) uint8, of 16 bits code / 257, rounded.
        bits: per component as stored.
        zero, scale: value = (code - zero) / scale at ``bits``.
        frame: of normals.
        changed: whether it is another than the one that was made.
    """

    codes: Callable[[], UInt8]
    bits: Literal[8, 16]
    zero: float
    scale: float
    frame: Literal["object", "tangent"] | None = None
    changed: bool = False


@dataclass(frozen=True)
class Surface(LitChart):
    """The surface on the chart, (H, W) texels, filled outside the islands.

    Attributes:
        chart: rasterised at this size.
        fallbacks: stable codes of missing or changed maps.
    """

    chart: Chart
    fallbacks: tuple[str, ...]


def build_surface(head: HeadModel, vertices: AnyFloat, maps: Mapping[str, StoredMap], size: Size) -> Surface:
    """Decode the maps (``ROLES``) and reduce them to (width, height): colours as linear light, normals with their
    variance.

    BadArchive: there is neither albedo nor texture, or a map cannot be read.
    """
    chart = Chart.build(head, *size)
    frame = chart.frame(vertices)
    axes = tuple(chart.fill_outside(axis) for axis in (frame.tangent, frame.bitangent, frame.normal))
    coloured = next((role for role in ("diffuse_albedo", "texture") if role in maps), None)
    if coloured is None:
        raise BadArchive(
            "the archive has neither maps/diffuse_albedo.png nor maps/texture.png; a picture needs one of them",
            map="diffuse_albedo",
        )
    fallbacks = [f"{role}-changed" for role, stored in maps.items() if stored.changed]
    fallbacks += ["diffuse_albedo-from-texture"] if coloured == "texture" else []
    fallbacks += [f"{role}-from-mesh" for role in ("diffuse_normal", "specular_normal") if role not in maps]
    fallbacks += [f"{role}-at-8-bits" for role, stored in maps.items() if stored.bits == 16]
    specular_normal, spread = _normals(maps.get("specular_normal"), axes, size)
    specular = np.full(size[::-1], SPECULAR, np.float32)
    if "specular_albedo" in maps:
        specular = _reduced(maps["specular_albedo"].codes(), size, lambda codes: codes * np.float32(1 / 255))[..., 0]
    else:
        fallbacks.append("specular_albedo-constant")
    wide = np.ones_like(spread)
    if "roughness" in maps:
        read = _reduced(maps["roughness"].codes(), size, lambda codes: codes * np.float32(1 / 255 / SKIN.roughness))
        wide = read[..., 0] ** 2
    # The variance of normals widens the lobes (LEAN mapping).
    lobes = [np.sqrt((alpha * wide) ** 2 + 2.0 * spread) for alpha in LOBES[:2]]
    metric = chart.metric(vertices)
    area = np.sqrt(np.maximum(metric[..., 0] * metric[..., 2] - metric[..., 1] ** 2, 1e-8))
    return Surface(
        position_m=chart.fill_outside(chart.interpolate(vertices)),
        normal=axes[2],
        tangent=axes[0],
        bitangent=axes[1],
        diffuse_normal=_normals(maps.get("diffuse_normal"), axes, size)[0],
        specular_normal=specular_normal,
        albedo=_reduced(maps[coloured].codes(), size, bytes_to_linear),
        specular=specular,
        alpha=np.asarray(np.clip(np.stack(lobes, -1), 0.0, 1.0), np.float32),
        share=np.full(spread.shape, LOBES[2], np.float32),
        texels_per_mm=np.asarray(np.minimum(1.0 / np.sqrt(chart.fill_outside(area)), _DENSEST), np.float32),
        skin=np.asarray(chart.part != NO_PART),
        chart=chart,
        fallbacks=tuple(fallbacks),
    )


def _reduced(codes: UInt8, size: Size, values: Callable[[UInt8], Float32]) -> Float32:
    """(H, W, 3) float32 means of values of codes over the area of each texel."""
    return resized(_halved(codes, size, values), size).reshape(size[1], size[0], 3)


def _halved(codes: UInt8, size: Size, values: Callable[[UInt8], Float32]) -> Float32:
    """(h, w, 3) means, in bands, over squares whose side is the largest power of two that leaves at least ``size``."""
    step, (height, width) = 1, codes.shape[:2]
    while width >= 2 * step * size[0] and height % (2 * step) == 0 and width % (2 * step) == 0:
        step *= 2
    bands = []
    for first in range(0, height, _BAND * step):
        band = values(codes[first : first + _BAND * step])
        bands.append(band.reshape(len(band) // step, step, width // step, step, -1).mean((1, 3)))
    return np.asarray(np.concatenate(bands), np.float32)


def _normals(stored: StoredMap | None, axes: tuple[Float32, ...], size: Size) -> tuple[Float32, Float32]:
    """Unit normals (H, W, 3) in head space, and the variance (H, W) of slopes within each texel.

    The mean of unit vectors is shorter than 1 by half their variance (Toksvig 2005).
    """
    if stored is None:
        return axes[2], np.zeros(size[::-1], np.float32)
    unit, zero, scale = (np.float32(v) for v in (257.0 if stored.bits == 16 else 1.0, stored.zero, stored.scale))
    small = _halved(stored.codes(), size, lambda codes: _unit((codes * unit - zero) / scale)[0])
    local, length = _unit(resized(small, size))
    spread = np.clip(1.0 / np.clip(length, 0.5, 1.0) - 1.0, 0.0, 1.0)
    if stored.frame == "tangent":
        local = sum((local[..., i : i + 1] * axes[i] for i in range(3)), np.zeros_like(local))
        local, _ = _unit(local, axes[2])
    return local, np.asarray(spread, np.float32)


def _unit(vectors: Float32, fallback: Float32 | None = None) -> tuple[Float32, Float32]:
    """Unit vectors (..., 3) and lengths (...); those without a direction are ``fallback``, or (0, 0, 1)."""
    length = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))
    sound = (length > 1e-3)[..., None]
    other = np.array([0, 0, 1], np.float32) if fallback is None else fallback
    made = np.where(sound, vectors / np.maximum(length, np.float32(1e-3))[..., None], other)
    return np.asarray(made, np.float32), np.asarray(length, np.float32)
