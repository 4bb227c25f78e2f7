"""Maps without the folds of the photo's expression, and the folds as maps of their own.

Of the relief only what is as coarse as a fold and slopes in the direction of the compression, by its structure tensor,
is taken: pores are finer, shape is coarser, and lines that run along the compression are the person's. Where nothing is
compressed no texel changes.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.arrays import Float32, UInt16
from service.reflectance.folds.creases import DIRECTIONS, GROUPS, Creases
from service.reflectance.result import NORMAL_ONE, Wrinkle, unpack_normals
from service.reflectance.texels import interpolated

WIDTH = 1536
"""Of the maps on which folds are found, texels: 3.75 to a mm of the face. Wrinkle maps are as large, but have no more
than half the sides of the other maps."""

FINEST, COARSEST = 1.0, 20.0
"""Standard deviations in those texels, 0.25 mm and 5 mm, of the Gaussians between which relief is a fold's."""

LINE = (0.15, 0.45)
"""Coherence of the structure tensor, from none to all of which relief is a line: pores and moles have no direction."""

AROUND = 4.0
"""Standard deviation in texels, 1 mm, of the Gaussian of the structure tensor."""

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
    slopes = [_band(-part / np.maximum(z, 0.05)) for part in (x, y)]
    fold = _share(creases, slopes[0], slopes[1])[..., None] * np.stack(slopes, -1)
    group = cv2.resize(creases.group, size, interpolation=cv2.INTER_NEAREST)
    wrinkles = []
    for name, units in creases.units.items():
        own = np.where((group == list(GROUPS).index(name))[..., None], fold, np.float32(0))
        if np.abs(own).max() > LEAST_SLOPE:
            half = _small((codes.shape[0] // 2, codes.shape[1] // 2))
            own = np.asarray(cv2.resize(own, half, interpolation=cv2.INTER_AREA), np.float32)
            wrinkles.append(Wrinkle(name, units, _codes(own)))
    return _without(codes, fold), tuple(wrinkles)


def unfolded_albedo(albedo: UInt16, creases: Creases) -> UInt16:
    """sRGB-coded albedo (H, W, 3) uint16 without the dark lines of an expression's folds.

    Each channel gets what it lacks to its surroundings. A gain would turn what is nearly black, as a cast shadow that
    lies along a fold, into its own hue: bright red.
    """
    import cv2

    size = _small(albedo.shape)
    small = np.asarray(cv2.resize(albedo, size, interpolation=cv2.INTER_AREA), np.float32)
    line = _band(np.log(np.maximum(small.mean(2), 1.0)))
    right, down = cv2.Sobel(line, cv2.CV_32F, 1, 0), cv2.Sobel(line, cv2.CV_32F, 0, 1)
    share = _share(creases, np.asarray(right, np.float32), -np.asarray(down, np.float32))
    lacks = [np.asarray(share * np.maximum(-_band(small[..., k]), 0), np.float32) for k in range(3)]
    out = albedo.copy()
    for rows, columns in _box(np.maximum.reduce(lacks) > 1, size, albedo.shape):
        part = np.dstack([_enlarged(one, albedo.shape, rows, columns) for one in lacks])
        out[rows, columns] = np.minimum(np.rint(albedo[rows, columns] + np.maximum(part, 0)), 65535)
    return out


def _small(shape: tuple[int, ...]) -> tuple[int, int]:
    """(width, height) of the maps on which folds are found."""
    width = min(shape[1], WIDTH)
    return width, max(width * shape[0] // shape[1], 1)


def _share(creases: Creases, x: Float32, y: Float32) -> Float32:
    """(h, w) in [0, 1], how much of relief with slopes (h, w) to the right and up is the expression's.

    The direction of lines is that of the larger eigenvector of the structure tensor, their coherence the difference of
    its eigenvalues over their sum (Bigun and Granlund 1987).
    """
    import cv2

    xx, yy, xy = (np.asarray(cv2.GaussianBlur(one, (0, 0), AROUND)) for one in (x * x, y * y, x * y))
    coherence = np.hypot(xx - yy, 2 * xy) / np.maximum(xx + yy, 1e-12)
    line = np.clip((coherence - LINE[0]) / (LINE[1] - LINE[0]), 0, 1)
    # Tent functions of the direction, with a period of pi.
    place = np.arctan2(2 * xy, xx - yy) / 2 * (DIRECTIONS / np.pi) % DIRECTIONS
    total = np.zeros_like(x)
    for k, weight in enumerate(creases.weights):
        apart = np.abs(place - k)
        tent = np.maximum(1 - np.minimum(apart, DIRECTIONS - apart), 0)
        if weight.any():
            total += np.asarray(tent * cv2.resize(weight, (x.shape[1], x.shape[0])), np.float32)
    return np.asarray(total * line, np.float32)


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
    """Values of a small plane at texels of the full map."""
    return interpolated(plane, (shape[1], shape[0]), np.r_[rows], np.r_[columns])
