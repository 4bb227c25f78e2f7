"""Maps without the folds of the photo's expression, and the folds as maps of their own.

Of the relief only what is as coarse as a fold and slopes across the compression is taken: pores are finer, shape is
coarser, and lines that run along the compression are the person's. Where nothing is compressed no texel changes.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.arrays import Float32, UInt16
from service.reflectance.folds.creases import GROUPS, Creases
from service.reflectance.result import NORMAL_ONE, Wrinkle, unpack_normals

WIDTH = 1536
"""Of the maps on which folds are found, and of wrinkle maps, texels: 3.75 to a mm of the face."""

FINEST, COARSEST = 1.3, 20.0
"""Standard deviations in those texels, 0.35 mm and 5 mm, of the Gaussians between which relief is a fold's."""

ALIGNED = (0.55, 0.75)
"""Share of the albedo's gradients that points across the fold, from none to all of a dark line taken for a crease."""

LEAST_SLOPE = 1e-3
"""A wrinkle map that is nowhere steeper is none."""


def unfolded(codes: npt.NDArray[np.int16], creases: Creases) -> tuple[npt.NDArray[np.int16], tuple[Wrinkle, ...]]:
    """Normals (H, W, 2) int16 without the folds of an expression, and the folds.

    Args:
        codes: x and y of tangent-space normals times ``NORMAL_ONE``, +Y up.
        creases: where they are.
    """
    import cv2

    size = _small(codes.shape)
    small = np.stack([cv2.resize(plane, size, interpolation=cv2.INTER_AREA) for plane in np.moveaxis(codes, 2, 0)], -1)
    x, y, z = np.moveaxis(unpack_normals(small.astype(np.float32)), 2, 0)
    weight, across, group = _at(creases, size)
    slopes = [_band(-part / np.maximum(z, 0.05)) for part in (x, y)]
    steep = weight * (slopes[0] * across[..., 0] + slopes[1] * across[..., 1])
    fold = steep[..., None] * across
    wrinkles = []
    for name, units in creases.units.items():
        own = np.where((group == list(GROUPS).index(name))[..., None], fold, np.float32(0))
        if np.abs(own).max() > LEAST_SLOPE:
            wrinkles.append(Wrinkle(name, units, _codes(own)))
    return _without(codes, fold), tuple(wrinkles)


def unfolded_albedo(albedo: UInt16, creases: Creases) -> UInt16:
    """sRGB-coded albedo (H, W, 3) uint16 without the dark lines of an expression's folds."""
    import cv2

    size = _small(albedo.shape)
    small = np.asarray(cv2.resize(albedo, size, interpolation=cv2.INTER_AREA), np.float32).mean(2)
    weight, across, _ = _at(creases, size)
    line = _band(np.log(np.maximum(small, 1.0)))
    right, down = cv2.Sobel(line, cv2.CV_32F, 1, 0), cv2.Sobel(line, cv2.CV_32F, 0, 1)
    along = right * across[..., 0] - down * across[..., 1]
    energy, own = (np.asarray(cv2.GaussianBlur(one, (0, 0), 4.0)) for one in (right**2 + down**2, along**2))
    share = own / np.maximum(energy, 1e-12)
    aligned = np.clip((share - ALIGNED[0]) / (ALIGNED[1] - ALIGNED[0]), 0, 1)
    gain = np.exp(-weight * aligned * np.minimum(line, 0)).astype(np.float32)
    out = albedo.copy()
    for rows, columns in _box(gain > 1 + 1e-3, size, albedo.shape):
        part = _enlarged(gain, albedo.shape, rows, columns)[..., None]
        lighter = np.minimum(np.rint(albedo[rows, columns] * part), 65535)
        out[rows, columns] = np.where(part > 1, lighter, albedo[rows, columns])
    return out


def _small(shape: tuple[int, ...]) -> tuple[int, int]:
    """(width, height) of the maps on which folds are found."""
    width = min(shape[1], WIDTH)
    return width, max(width * shape[0] // shape[1], 1)


def _at(creases: Creases, size: tuple[int, int]) -> tuple[Float32, Float32, npt.NDArray[np.uint8]]:
    """Weight, direction and group at a size. A direction without a sign is interpolated as its double angle."""
    import cv2

    weight = np.asarray(cv2.resize(creases.weight, size, interpolation=cv2.INTER_LINEAR), np.float32)
    angle = 2 * np.arctan2(creases.across[..., 1], creases.across[..., 0])
    twice = [cv2.resize(np.asarray(part, np.float32), size) for part in (np.cos(angle), np.sin(angle))]
    half = np.arctan2(twice[1], twice[0]) / 2
    across = np.stack([np.cos(half), np.sin(half)], -1).astype(np.float32)
    group = np.asarray(cv2.resize(creases.group, size, interpolation=cv2.INTER_NEAREST), np.uint8)
    return weight, across, group


def _band(plane: Float32) -> Float32:
    import cv2

    plane = np.asarray(plane, np.float32)
    return np.asarray(cv2.GaussianBlur(plane, (0, 0), FINEST) - cv2.GaussianBlur(plane, (0, 0), COARSEST), np.float32)


def _codes(slopes: Float32) -> npt.NDArray[np.int16]:
    """(h, w, 2) int16 normals of slopes (h, w, 2)."""
    length = np.sqrt(1 + np.einsum("hwi,hwi->hw", slopes, slopes))[..., None]
    return np.asarray(np.rint(-slopes / length * NORMAL_ONE), np.int16)


def _without(codes: npt.NDArray[np.int16], fold: Float32) -> npt.NDArray[np.int16]:
    """Normals less slopes (h, w, 2); texels without any stay as they are."""
    out = codes.copy()
    size = (fold.shape[1], fold.shape[0])
    for rows, columns in _box(np.abs(fold).max(2) > 0, size, codes.shape):
        own = codes[rows, columns]
        x, y, z = np.moveaxis(unpack_normals(own), 2, 0)
        less = np.stack([_enlarged(fold[..., k], codes.shape, rows, columns) for k in (0, 1)], -1)
        steep = -np.stack([x, y], -1) / np.maximum(z, 0.05)[..., None] - less
        out[rows, columns] = np.where((less != 0).any(-1, keepdims=True), _codes(steep), own)
    return out


def _box(mask: npt.NDArray[np.bool_], size: tuple[int, int], shape: tuple[int, ...]) -> list[tuple[slice, slice]]:
    """Rows and columns of the full map that texels of a small one (h, w) are on, with a margin, in bands."""
    if not mask.any():
        return []
    tall, wide = shape[0] / size[1], shape[1] / size[0]
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    top, bottom = max(int((rows[0] - 1) * tall), 0), min(int(np.ceil((rows[-1] + 2) * tall)), shape[0])
    left, right = max(int((columns[0] - 1) * wide), 0), min(int(np.ceil((columns[-1] + 2) * wide)), shape[1])
    return [(slice(at, min(at + 256, bottom)), slice(left, right)) for at in range(top, bottom, 256)]


def _enlarged(plane: Float32, shape: tuple[int, ...], rows: slice, columns: slice) -> Float32:
    """Bilinear values of a small plane at texels of the full map."""
    import cv2

    tall, wide = plane.shape[0] / shape[0], plane.shape[1] / shape[1]
    y = ((np.arange(rows.start, rows.stop) + 0.5) * tall - 0.5).astype(np.float32)
    x = ((np.arange(columns.start, columns.stop) + 0.5) * wide - 0.5).astype(np.float32)
    grid = np.meshgrid(x, y)
    return np.asarray(cv2.remap(plane, grid[0], grid[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)
