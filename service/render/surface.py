"""The surface of an avatar as maps at the resolution of a picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from service.archive.reading import StoredMap, unpack_map
from service.arrays import AnyFloat, Bool, Float32
from service.colour import bytes_to_linear
from service.errors import BadArchive
from service.geometry.chart import NO_PART, Chart
from service.head.model import HeadModel
from service.materials.of_head import material_of

Size = tuple[int, int]

ROLES = ("diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal", "texture")
"""Maps that a render uses; the texture only where there is no albedo."""

SPECULAR = 0.65
"""Specular albedo where there is no map: F0 = 0.026, between water and dry skin."""

LOBES = (0.25, 0.48, 0.75)
"""Skin: GGX alpha of both lobes and weight of the first, the middle of the light stage's ranges."""

LARGEST = 3072
"""Widest chart that is lit; a picture of 4096 pixels resolves no more of a head."""

_BAND = 64
"""Rows of the reduced map computed at once."""
_DENSEST = 12.0
"""Most texels per mm for which the scattering network is exported."""


@dataclass(frozen=True)
class Surface:
    """Maps on the chart, (H, W) texels, filled outside the islands.

    Attributes:
        chart: rasterised at this size.
        position_m: (H, W, 3) metres, head space.
        normal, tangent, bitangent: (H, W, 3) smooth unit frame, head space.
        diffuse_normal, specular_normal: (H, W, 3) unit, head space.
        albedo: (H, W, 3) linear in [0, 1].
        specular: (H, W) in [0, 1].
        alpha: (H, W, 2) GGX alpha of both lobes; ``share`` (H, W) weight of the first, 1 where there is one only.
        texels_per_mm: (H, W).
        skin: (H, W) bool, texels where light scatters.
        fallbacks: stable codes of missing or changed maps.
    """

    chart: Chart
    position_m: Float32
    normal: Float32
    tangent: Float32
    bitangent: Float32
    diffuse_normal: Float32
    specular_normal: Float32
    albedo: Float32
    specular: Float32
    alpha: Float32
    share: Float32
    texels_per_mm: Float32
    skin: Bool
    fallbacks: tuple[str, ...]


def build_surface(head: HeadModel, vertices: AnyFloat, maps: Mapping[str, StoredMap], size: Size) -> Surface:
    """Decode the maps and reduce them to a size: colours as linear light, normals with their variance.

    Args:
        head: topology and chart.
        vertices: (V, 3) metres.
        maps: by role; see ``ROLES``.
        size: (width, height) of the result.

    Raises:
        BadArchive: there is neither albedo nor texture, or a map cannot be read.
    """
    chart = Chart.build(head, *size)
    frame = chart.frame(vertices)
    axes = tuple(chart.fill_outside(axis) for axis in (frame.tangent, frame.bitangent, frame.normal))
    fallbacks: list[str] = [f"{role}-changed" for role, stored in maps.items() if stored.changed]
    albedo = _albedo(maps, size, fallbacks)
    specular_normal, spread = _normals(maps.get("specular_normal"), axes, size)
    diffuse_normal, _ = _normals(maps.get("diffuse_normal"), axes, size)
    fallbacks += [f"{role}-from-mesh" for role in ("diffuse_normal", "specular_normal") if role not in maps]
    fallbacks += [f"{role}-at-8-bits" for role, stored in maps.items() if stored.bits == 16]
    specular = np.full(size[::-1], SPECULAR, np.float32)
    if "specular_albedo" in maps:
        specular = _reduced(maps["specular_albedo"], size)[..., 0]
    else:
        fallbacks.append("specular_albedo-constant")
    alpha, share = _lobes(chart, spread)
    return Surface(
        chart=chart,
        position_m=chart.fill_outside(chart.interpolate(vertices)),
        normal=axes[2],
        tangent=axes[0],
        bitangent=axes[1],
        diffuse_normal=diffuse_normal,
        specular_normal=specular_normal,
        albedo=albedo,
        specular=specular,
        alpha=alpha,
        share=share,
        texels_per_mm=_density(chart, vertices),
        skin=_is_skin(chart),
        fallbacks=tuple(fallbacks),
    )


def _albedo(maps: Mapping[str, StoredMap], size: Size, fallbacks: list[str]) -> Float32:
    if "diffuse_albedo" in maps:
        return _reduced(maps["diffuse_albedo"], size, colours=True)
    if "texture" in maps:
        fallbacks.append("diffuse_albedo-from-texture")
        return _reduced(maps["texture"], size, colours=True)
    raise BadArchive(
        "the archive has neither maps/diffuse_albedo.png nor maps/texture.png; a picture needs one of them",
        map="diffuse_albedo",
    )


def _reduced(stored: StoredMap, size: Size, *, colours: bool = False) -> Float32:
    """(H, W, 3) float32 means over the area of each texel: linear light of sRGB colours, else code / 255."""
    import cv2

    codes = unpack_map(stored.png, stored.role)
    way = cv2.INTER_AREA if codes.shape[1] > size[0] else cv2.INTER_LINEAR
    step = _step(codes.shape, size)
    small = np.zeros((codes.shape[0] // step, codes.shape[1] // step, 3), np.float32)
    for first in range(0, codes.shape[0], _BAND * step):
        band = codes[first : first + _BAND * step]
        values = bytes_to_linear(band) if colours else band * np.float32(1 / 255)
        small[first // step : first // step + _BAND] = _means(values, step)
    return np.asarray(cv2.resize(small, size, interpolation=way), np.float32).reshape(size[1], size[0], 3)


def _step(shape: tuple[int, ...], size: Size) -> int:
    """Largest power of two that divides the map and leaves it no smaller than ``size``."""
    step = 1
    while shape[1] >= 2 * step * size[0] and shape[0] % (2 * step) == 0 and shape[1] % (2 * step) == 0:
        step *= 2
    return step


def _means(values: Float32, step: int) -> Float32:
    height, width = values.shape[0] // step, values.shape[1] // step
    return np.asarray(values.reshape(height, step, width, step, -1).mean((1, 3)), np.float32)


def _normals(stored: StoredMap | None, axes: tuple[Float32, ...], size: Size) -> tuple[Float32, Float32]:
    """Unit normals (H, W, 3) in head space, and the variance (H, W) of slopes within each texel.

    The mean of unit vectors is shorter than 1 by half their variance (Toksvig 2005).
    """
    import cv2

    if stored is None:
        return axes[2], np.zeros(size[::-1], np.float32)
    codes = unpack_map(stored.png, stored.role)
    step = _step(codes.shape, size)
    small = np.zeros((codes.shape[0] // step, codes.shape[1] // step, 3), np.float32)
    # 16-bit codes are decoded as code / 257, rounded.
    unit = 257.0 if stored.bits == 16 else 1.0
    for first in range(0, codes.shape[0], _BAND * step):
        vectors = (codes[first : first + _BAND * step] * np.float32(unit) - np.float32(stored.zero)) / np.float32(
            stored.scale
        )
        small[first // step : first // step + _BAND] = _means(_unit(vectors)[0], step)
    way = cv2.INTER_AREA if small.shape[1] > size[0] else cv2.INTER_LINEAR
    mean = np.asarray(cv2.resize(small, size, interpolation=way), np.float32)
    local, length = _unit(mean)
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


def _lobes(chart: Chart, spread: Float32) -> tuple[Float32, Float32]:
    """(H, W, 2) alpha and (H, W) weight by part; the variance of normals widens the lobes (LEAN mapping)."""
    first, second, share = (np.full(spread.shape, value, np.float32) for value in LOBES)
    part = chart.fill_outside(chart.part)
    for index, name in enumerate(chart.head.part_names):
        material = material_of(name)
        if not material.detailed:
            here = part == index
            first[here] = second[here] = material.roughness**2
            share[here] = 1.0
    alphas = [np.sqrt(alpha * alpha + 2.0 * spread) for alpha in (first, second)]
    return np.asarray(np.clip(np.stack(alphas, -1), 0.0, 1.0), np.float32), share


def _density(chart: Chart, vertices: AnyFloat) -> Float32:
    """(H, W) square root of texels per mm^2, at most ``_DENSEST``."""
    metric = chart.metric(vertices)
    area = np.sqrt(np.maximum(metric[..., 0] * metric[..., 2] - metric[..., 1] ** 2, 1e-8))
    return np.asarray(np.minimum(1.0 / np.sqrt(chart.fill_outside(area)), _DENSEST), np.float32)


def _is_skin(chart: Chart) -> Bool:
    detailed = [i for i, name in enumerate(chart.head.part_names) if material_of(name).detailed]
    return np.asarray(np.isin(chart.part, detailed) & (chart.part != NO_PART))
