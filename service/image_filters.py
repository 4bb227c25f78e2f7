"""Filters of images and maps, float32 in and out: the few that most stages share."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import numpy.typing as npt

from service.arrays import AnyFloat, Bool, Float32

Image = npt.NDArray[np.integer | np.floating]
"""(h, w) or (h, w, C) of any type that OpenCV takes."""


def blurred(image: Image, sigma: float) -> Float32:
    """Gaussian blur with a standard deviation in texels; beyond its border the image goes on as its mirror image."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.float32)


def shrunk(image: Image, size: tuple[int, int]) -> Float32:
    """The image at (width, height): means over the area of the new texels."""
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)


def stretched_to(image: Image, size: tuple[int, int]) -> Float32:
    """The image at (width, height), interpolated bilinearly between the centres of its texels."""
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR), np.float32)


def ramp(value: AnyFloat, between: tuple[float, float]) -> Float32:
    """0 up to the first of two values, 1 from the second on, straight between."""
    return np.asarray(np.clip((value - between[0]) / (between[1] - between[0]), 0, 1), np.float32)


def strips(height: int, rows: int) -> Iterator[slice]:
    """Rows of a map, so many at a time."""
    return (slice(top, min(top + rows, height)) for top in range(0, height, rows))


def marked_columns(marked: Bool, size: tuple[int, int], rows: slice, grid: int = 1) -> tuple[int, int] | None:
    """First column, and column after the last, of a map of (width, height) that marks can reach within some rows.

    Args:
        marked: (h, w) of the same chart, coarser than the map.
        size: of the map.
        rows: of the map.
        grid: what the columns are rounded to, outwards.

    Returns:
        None where there are no marks.
    """
    down, across = marked.shape[0] / size[1], size[0] / marked.shape[1]
    part = marked[max(int(rows.start * down) - 1, 0) : int(np.ceil(rows.stop * down)) + 1]
    where = np.flatnonzero(part.any(0))
    if not len(where):
        return None
    first = max(int((where[0] - 1) * across) // grid * grid, 0)
    return first, min(-(-int((where[-1] + 2) * across) // grid) * grid, size[0])
