"""Sampling: images between pixels, bilinear or averaged over a footprint, and surfaces by points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from service.arrays import AnyFloat, AnyInt, Float32, Float64, UInt8

_COLUMNS, _ROWS = 1024, 16384
"""Points per call of ``cv2.remap``: neither side of its maps may reach 32768."""

OVERLAP = 1.4
"""Spacing of samples in pixels: bilinear interpolation averages over what lies between them."""


def sample_at(image: UInt8 | Float32, x: Float32, y: Float32) -> UInt8 | Float32:
    """(N, C) bilinear values of an image (H, W, C) or (H, W) at (N,) columns and rows, of its type.

    Any number of points and channels; pixel centres are whole numbers, borders are repeated.
    """
    import cv2

    planes, count = image[..., None] if image.ndim == 2 else image, len(x)
    rows = max(-(-count // _COLUMNS), 1)
    places = np.zeros((2, rows * _COLUMNS), np.float32)
    places[0, :count], places[1, :count] = x, y
    maps = places.reshape(2, rows, _COLUMNS)
    values = np.zeros((rows, _COLUMNS, planes.shape[2]), image.dtype)
    for first in range(0, planes.shape[2], 4):  # OpenCV takes four channels
        chosen: npt.NDArray[Any] = np.ascontiguousarray(planes[..., first : first + 4])
        for row in range(0, rows, _ROWS):
            part = slice(row, row + _ROWS)
            read = cv2.remap(chosen, maps[0, part], maps[1, part], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            values[part, :, first : first + 4] = np.asarray(read).reshape(*values[part].shape[:2], -1)
    return values.reshape(rows * _COLUMNS, -1)[:count]


def sample_chart(image: UInt8 | Float32, uv: Float32) -> Float32:
    """(N, C) float32 bilinear values of a chart image (H, W, C) or (H, W) at (N, 2) chart coordinates in [0, 1].

    Chart coordinates have their origin at the bottom left; borders are repeated. Codes of uint8 stay in [0, 255].
    """
    height, width = image.shape[:2]
    return np.asarray(sample_at(image, uv[:, 0] * width - 0.5, (1 - uv[:, 1]) * height - 0.5), np.float32)


@dataclass(frozen=True)
class Pyramid:
    """An image at successively halved resolutions.

    Attributes:
        levels: level i is (about H / 2^i, about W / 2^i, C) float32, each pixel the mean of 2 x 2 of the level below
            (Williams 1983). Values keep the range of the image; average linear light, not coded values.
        scales: (w, h) of each level's pixel in pixels of level 0 (not quite powers of two for odd sizes).
    """

    levels: tuple[Float32, ...]
    scales: tuple[tuple[float, float], ...]

    @classmethod
    def build(cls, image: AnyFloat) -> Pyramid:
        """From (H, W, C) or (H, W), both sides at least 1 and at most 32767."""
        import cv2

        base = np.ascontiguousarray(image, np.float32)
        base = base[..., None] if base.ndim == 2 else base
        levels = [base]
        while max(levels[-1].shape[:2]) > 1:
            height, width = levels[-1].shape[:2]
            size = (max(1, width // 2), max(1, height // 2))
            smaller = cv2.resize(levels[-1], size, interpolation=cv2.INTER_AREA)
            levels.append(np.asarray(smaller, np.float32).reshape(size[1], size[0], -1))
        h, w = base.shape[:2]
        return cls(tuple(levels), tuple((w / a.shape[1], h / a.shape[0]) for a in levels))

    def sample(self, points: AnyFloat, footprint: AnyFloat | float = 1.0) -> Float32:
        """(..., C) means around points (..., 2), interpolated between pixels and between levels.

        Args:
            points: pixels, x right, y down, pixel centres at +0.5. Outside the image the border is repeated; points
                that are not finite read the top left corner.
            footprint: (...) diameter of the area in pixels; below 1 counts as 1.
        """
        at = np.nan_to_num(np.asarray(points, np.float32), nan=0.0, posinf=0.0, neginf=0.0)
        shape = at.shape[:-1]
        at = at.reshape(-1, 2)
        diameter = np.nan_to_num(np.broadcast_to(np.asarray(footprint, np.float32), shape).reshape(-1), nan=1.0)
        level = np.clip(np.log2(np.maximum(diameter, np.float32(1))), 0, len(self.levels) - 1)
        result = np.zeros((len(at), self.levels[0].shape[2]), np.float32)
        lower = np.floor(level).astype(np.int32)
        for i in range(int(lower.max(initial=-1)) + 1):
            chosen = np.flatnonzero(lower == i)
            if not len(chosen):
                continue
            result[chosen] = self._read(i, at[chosen])
            between = chosen[level[chosen] > i]
            if len(between):
                share = (level[between] - np.float32(i))[:, None]
                result[between] += share * (self._read(i + 1, at[between]) - result[between])
        return result.reshape(*shape, result.shape[1])

    def _read(self, level: int, points: Float32) -> Float32:
        image, scale = self.levels[level], self.scales[level]
        x, y = (np.clip(points[:, k] / scale[k] - 0.5, -1.0, image.shape[1 - k]).astype(np.float32) for k in (0, 1))
        return np.asarray(sample_at(image, x, y), np.float32)


def sample_area(pyramid: Pyramid, points: AnyFloat, jacobian: AnyFloat) -> Float32:
    """(..., C) means over the parallelograms onto which unit squares are mapped, by regular supersampling.

    A texel seen at a grazing angle is long and narrow in the photo; several samples along it avoid the blur or aliasing
    of a single round footprint.

    Args:
        pyramid: of the image.
        points: (..., 2) centres in pixels (centres of pixels at +0.5).
        jacobian: (..., 2, 2) d(pixel x, y) / d(texel x, y).
    """
    j = np.nan_to_num(np.asarray(jacobian, np.float32))
    longest = np.sqrt(np.maximum(j[..., 0, 0] ** 2 + j[..., 1, 0] ** 2, j[..., 0, 1] ** 2 + j[..., 1, 1] ** 2))
    wide = float(np.percentile(longest, 75)) / OVERLAP if longest.size else 1.0
    # Most samples per side of a footprint; larger footprints read coarser levels of the pyramid.
    side = int(np.clip(np.ceil(wide), 1, 3))
    centre, along_x, along_y = np.asarray(points, np.float32), j[..., 0], j[..., 1]
    offsets = ((np.arange(side) + 0.5) / side - 0.5).astype(np.float32)
    total = np.zeros((*longest.shape, pyramid.levels[0].shape[2]), np.float32)
    for dx in offsets:
        for dy in offsets:
            total += pyramid.sample(centre + dx * along_x + dy * along_y, longest / np.float32(side * OVERLAP))
    total /= side * side
    return total


def surface_points(vertices: AnyFloat, triangles: AnyInt, spacing: float) -> Float32:
    """(N, 3) float32 points on all triangles, degenerate ones too, at most ``spacing`` apart.

    Args:
        vertices: (V, 3) in the unit of ``spacing``.
        triangles: (T, 3) vertex indices.
        spacing: largest distance of neighbours; a triangle's side is divided into at most 256 parts.
    """
    corners = np.asarray(vertices, np.float64)[triangles]
    edges = np.linalg.norm(corners - np.roll(corners, 1, 1), axis=2).max(1)
    steps = np.clip(np.ceil(edges / spacing), 1, 256).astype(int)
    points = []
    for n in np.unique(steps):
        i, j = np.divmod(np.arange((n + 1) ** 2), n + 1)
        keep = i + j <= n
        weights = np.stack([i, j, n - i - j], 1)[keep] / n
        points.append(np.einsum("kc,tcd->tkd", weights, corners[steps == n]).reshape(-1, 3))
    if not points:
        return np.zeros((0, 3), np.float32)
    return thinned(np.concatenate(points), 1e-3 * spacing).astype(np.float32)


def thinned(points: Float64, grain: float) -> Float64:
    """(M, 3) of points (N, 3), N > 0: one per cube of side ``grain``; triangles share corners and edges."""
    cell = np.rint((points - points.min(0)) / grain).astype(np.int64)
    x, y, z = np.minimum(cell, (1 << 21) - 1).T
    _, first = np.unique((x << 42) | (y << 21) | z, return_index=True)
    return np.asarray(points[np.sort(first)])
