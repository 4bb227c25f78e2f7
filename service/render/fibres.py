"""Strands finer than the samples of a picture: means of what their texture shows, and ribbons one sample wide.

From afar several texels lie across one sample; who reads one of them draws strands as dotted lines. A ribbon seen from
its edge lies between samples along most of its length; it is drawn one sample wide and as much fainter, as wires are
(Persson 2012, "Phone-wire AA").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.arrays import Float32, Float64, Int32, Int64, UInt8
from service.geometry.raster import signed_area
from service.geometry.sampling import sample_at
from service.materials.material import Material, OwnMap
from service.materials.part import MeshPart

EDGE = 0.15
"""Width of the ramp of alpha around the cutoff of a masked part: a hard step would flicker."""
COARSEST = 5
"""Halvings of the columns in the coarsest level: a lock of hair has hardly more texels across."""
LONG = 2
"""Halvings by which rows are behind columns: texels of strands, which run along v, are about four times as long as
wide."""


def cut(alpha: Float32, material: Material) -> Float32:
    """(N,) opacity in [0, 1] of alpha (N,) by a material, which may cut it off."""
    if material.alpha != "mask":
        return alpha
    return np.asarray(np.clip((alpha - material.cutoff) / np.float32(EDGE) + np.float32(0.5), 0, 1), np.float32)


@dataclass(frozen=True)
class StrandTexture:
    """A texture of strands along v, at several widths side by side.

    Attributes:
        pixels: (h, W, 4) uint8 sRGB and opacity: the texture, and means over 2, 4, ... of its columns.
        widths: (L,) of the levels, and their first columns ``starts`` (L,).
    """

    pixels: UInt8
    widths: Int64
    starts: Int64

    @classmethod
    def of(cls, picture: OwnMap, material: Material) -> StrandTexture:
        """That of a material with alpha."""
        import cv2

        height, width = picture.pixels.shape[:2]
        shown = cut(material.opacity * np.arange(256, dtype=np.float32) / np.float32(255), material)
        whole = picture.pixels.copy()
        alpha = np.ascontiguousarray(whole[..., 3])
        whole[..., 3] = cv2.LUT(alpha, np.rint(255 * shown).astype(np.uint8))
        levels = [whole]
        for level in range(1, COARSEST + 1):
            size = max(width >> level, 1), max(height >> max(level - LONG, 0), 1)
            whole = np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), np.uint8)
            levels.append(np.asarray(cv2.resize(whole, (size[0], height), interpolation=cv2.INTER_LINEAR), np.uint8))
        widths = np.array([one.shape[1] for one in levels])
        return cls(np.concatenate(levels, 1), widths, np.cumsum(widths) - widths)

    def levels(self, flat: Float64, triangles: Int32, places: Float32) -> Int64:
        """(T,) level whose columns are about as wide as a sample.

        Triangles (T, 3) of points ``flat`` (V, 2) in samples, their ``places`` (T, 3, 2) on the texture.
        """
        p, u = flat[triangles], places[..., 0].astype(np.float64)
        (x1, x2), (u1, u2) = ((q[:, 1] - q[:, 0], q[:, 2] - q[:, 0]) for q in (p, u))
        twice = np.maximum(np.abs(signed_area(flat, triangles)), 1e-9)
        columns = np.hypot(x2[:, 1] * u1 - x1[:, 1] * u2, x1[:, 0] * u2 - x2[:, 0] * u1) / twice * self.widths[0]
        level = np.rint(np.log2(np.clip(np.nan_to_num(columns), 1, 1 << COARSEST)))
        return np.asarray(level, np.int64)

    def read(self, uv: Float32, level: Int64) -> Float32:
        """(N, 4) sRGB and opacity in [0, 1] at places (N, 2) of levels (N,), bilinear."""
        width = self.widths[level].astype(np.float32)
        column = np.clip(uv[:, 0] * width - np.float32(0.5), 0, width - 1) + self.starts[level].astype(np.float32)
        row = (1 - uv[:, 1]) * self.pixels.shape[0] - np.float32(0.5)
        return np.asarray(sample_at(self.pixels, column, row) / np.float32(255), np.float32)


def strand_textures(parts: Sequence[MeshPart]) -> list[StrandTexture | None]:
    """That of each part, None where its material has no texture with alpha; parts of one look share theirs."""
    made: dict[tuple[object, ...], StrandTexture] = {}
    found: list[StrandTexture | None] = []
    for part in parts:
        material, picture = part.material, part.material.colour_map
        if not (isinstance(picture, OwnMap) and picture.has_alpha and material.alpha != "opaque"):
            found.append(None)
            continue
        look = picture, material.alpha, material.cutoff, material.opacity
        if look not in made:
            made[look] = StrandTexture.of(picture, material)
        found.append(made[look])
    return found


def widened(flat: Float64, triangles: Int32) -> tuple[Float64, Int32, Int64, Float32]:
    """Triangles of ribbons whose heights are at least one sample.

    Args:
        flat: (V, 2) corners in samples.
        triangles: (T, 3).

    Returns:
        (V + K, 2) corners, the given ones first; (T, 3) triangles of these; (V + K,) which corner each was; and (T,)
        the height that triangles had, at most 1: two that share their long side are a ribbon as wide.
    """
    corner = flat[triangles]
    sides = np.roll(corner, 1, 1) - np.roll(corner, -1, 1)  # each beside the corner that it faces
    length = np.hypot(sides[..., 0], sides[..., 1])
    tip = length.argmax(1)
    each = np.arange(len(triangles))
    longest = np.maximum(length[each, tip], 1e-9)
    twice = signed_area(flat, triangles)
    height = np.abs(twice) / longest
    thin = np.flatnonzero(height < 1)
    side = sides[thin, tip[thin]] / longest[thin, None] * np.where(twice[thin] < 0, -1, 1)[:, None]
    away = np.column_stack([-side[:, 1], side[:, 0]]) * (1 - height[thin])[:, None]
    moved = triangles[thin, tip[thin]]
    made = triangles.copy()
    made[thin, tip[thin]] = len(flat) + np.arange(len(thin))
    corners = np.concatenate([flat, flat[moved] + away])
    return corners, made, np.concatenate([np.arange(len(flat)), moved]), np.minimum(height, 1).astype(np.float32)
