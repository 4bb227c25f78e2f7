"""Filters of images and maps, float32 in and out: the few that most stages share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import reduce
from typing import Any, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from service.arrays import AnyFloat, Bool, Float32

T = TypeVar("T")

Image = npt.NDArray[np.integer | np.floating]
"""(h, w) or (h, w, C) of any type that OpenCV takes."""


WIDE = 8.0
"""Standard deviation, texels, from which on a blur is made on a smaller image."""


def blurred(image: Image, sigma: float) -> Float32:
    """Gaussian blur with a standard deviation in texels; beyond its border the image goes on as its mirror image.

    A wide one is made on means over squares of texels, an eighth to a quarter of its width, and interpolated, which
    blur a little themselves; its kernel would have hundreds of texels.
    """
    step = 2 ** int(np.log2(max(sigma / (WIDE / 2), 1)))
    reach, (height, width) = -(-int(4 * sigma) // step) * step, image.shape[:2]
    if step == 1:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.float32)
    sides = (reach, reach - height % -step, reach, reach - width % -step)
    padded = cv2.copyMakeBorder(image, *sides, cv2.BORDER_REFLECT_101)
    tall, wide = padded.shape[:2]
    small = shrunk(padded, (wide // step, tall // step))
    # The variances of the mean over a square and of the interpolation, (step^2 - 1) / 12 and (2 step^2 + 1) / 12.
    soft = cv2.GaussianBlur(small, (0, 0), float(np.sqrt((sigma / step) ** 2 - 0.25)))
    whole = stretched_to(np.asarray(soft, np.float32), (wide, tall))
    return np.ascontiguousarray(whole[reach : reach + height, reach : reach + width])


def shrunk(image: Image, size: tuple[int, int]) -> Float32:
    """The image at (width, height): means over the area of the new texels."""
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)


def stretched_to(image: Image, size: tuple[int, int]) -> Float32:
    """The image at (width, height), interpolated bilinearly between the centres of its texels."""
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR), np.float32)


def resized(image: Image, size: tuple[int, int]) -> npt.NDArray[Any]:
    """The image at (width, height), of its own type: by area where it becomes narrower, else bilinearly."""
    way = cv2.INTER_AREA if size[0] <= image.shape[1] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(np.ascontiguousarray(image), size, interpolation=way))


def ramp(value: AnyFloat, between: tuple[float, float]) -> Float32:
    """0 up to the first of two values, 1 from the second on, straight between."""
    return np.asarray(np.clip((value - between[0]) / (between[1] - between[0]), 0, 1), np.float32)


def strips(height: int, rows: int) -> Iterator[slice]:
    """Rows of a map, so many at a time."""
    return (slice(top, min(top + rows, height)) for top in range(0, height, rows))


STRIP = 64
"""Rows of a strip of :func:`by_strips`: its planes, 1.5 MB of a map of 6144 texels, stay in the processor's cache."""


def by_strips(height: int, work: Callable[[slice], T], rows: int = STRIP) -> list[T]:
    """What ``work`` gives for strips of a map, in order; two are worked on at once, so they must not overlap."""
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(work, strips(height, rows)))


def most(image: Image) -> npt.NDArray[np.floating]:
    """(h, w) largest of the channels (h, w, C): numpy's own maximum over a short last axis takes twenty times as
    long.
    """
    return reduce(np.maximum, np.moveaxis(image, -1, 0))


def least(image: Image) -> npt.NDArray[np.floating]:
    """(h, w) smallest of the channels (h, w, C)."""
    return reduce(np.minimum, np.moveaxis(image, -1, 0))


def marked_columns(marked: Bool, size: tuple[int, int], rows: slice, grid: int = 1) -> tuple[int, int] | None:
    """First column, and column after the last, of a map of (width, height) that marks can reach within some rows.

    The marks (h, w) are of the same chart, coarser than the map; columns are rounded to a ``grid``, outwards. None
    where there are no marks.
    """
    down, across = marked.shape[0] / size[1], size[0] / marked.shape[1]
    part = marked[max(int(rows.start * down) - 1, 0) : int(np.ceil(rows.stop * down)) + 1]
    where = np.flatnonzero(part.any(0))
    if not len(where):
        return None
    first = max(int((where[0] - 1) * across) // grid * grid, 0)
    return first, min(-(-int((where[-1] + 2) * across) // grid) * grid, size[0])


ACROSS = 1024
"""Columns of a strip of :func:`each_around`: several planes of it stay in the cache."""


def each_around(mask: Bool, shape: tuple[int, ...], change: Callable[[slice, slice], None]) -> None:
    """Call a function of rows and columns for parts of the full map that texels of a small one (h, w) lie on."""
    tall, wide = shape[:2]
    across = mask.shape[1] / wide

    def work(rows: slice) -> None:
        first, beyond = marked_columns(mask, (wide, tall), rows) or (0, 0)
        for begin in range(first, beyond, ACROSS):
            end = min(begin + ACROSS, beyond)
            near = slice(max(int(begin * across) - 1, 0), int(np.ceil(end * across)) + 1)
            if marked_columns(mask[:, near], (end - begin, tall), rows) is not None:
                change(rows, slice(begin, end))

    by_strips(tall, work)
