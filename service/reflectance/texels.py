"""Values at texels of a map: picked from planes of its size, or interpolated from coarser planes of the same chart."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from service.arrays import Float32
from service.runtime.tiles import Indices


def interpolated(plane: Float32, size: tuple[int, int], rows: Indices, columns: Indices) -> Float32:
    """(len(rows), len(columns)) float32, bilinear values of a coarse (h, w) plane at texels of a map of ``size``.

    Args:
        plane: (h, w), on the same chart as the map.
        size: (width, height) of the map.
        rows: of the map.
        columns: of the map.
    """
    result = np.zeros((len(rows), len(columns)), np.float32)
    interpolate(plane, size, rows, columns, result)
    return result


def interpolate(plane: Float32, size: tuple[int, int], rows: Indices, columns: Indices, into: Float32) -> None:
    """The same as :func:`interpolated`, written into an existing plane."""
    tall, wide = size[1] / plane.shape[0], size[0] / plane.shape[1]
    if not (tall.is_integer() and wide.is_integer()) or not into.size:
        into[...] = _interpolated_anywhere(plane, size, rows, columns)
        return
    block, first_row, first_column = _enlarged_block(plane, int(tall), int(wide), rows, columns)
    pick(block, rows - first_row, columns - first_column, into)


def _enlarged_block(plane: Float32, tall: int, wide: int, rows: Indices, columns: Indices) -> tuple[Float32, int, int]:
    """Part of the plane around some texels, enlarged by integer factors, and row and column of its first texel.

    OpenCV is several times as fast as indexing. One more coarse texel on each side keeps its border handling out of the
    result.
    """
    import cv2

    top, bottom = max(int(rows.min()) // tall - 1, 0), min(int(rows.max()) // tall + 2, plane.shape[0])
    left, right = max(int(columns.min()) // wide - 1, 0), min(int(columns.max()) // wide + 2, plane.shape[1])
    part = np.ascontiguousarray(plane[top:bottom, left:right])
    size = ((right - left) * wide, (bottom - top) * tall)
    return np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_LINEAR)), top * tall, left * wide


def _interpolated_anywhere(plane: Float32, size: tuple[int, int], rows: Indices, columns: Indices) -> Float32:
    """As :func:`interpolated`, for any ratio of sizes."""
    above, below, down = _between(plane.shape[0], size[1], rows)
    left, right, across = _between(plane.shape[1], size[0], columns)
    lines = plane[:, left] * (1 - across) + plane[:, right] * across
    result: Float32 = lines[above] * (1 - down[:, None])
    result += lines[below] * down[:, None]
    return result


def _between(coarse: int, fine: int, index: Indices) -> tuple[Indices, Indices, Float32]:
    """The two coarse texels on either side of the centre of each fine one, and the weight of the second."""
    position = np.clip((index + 0.5) * (coarse / fine) - 0.5, 0, coarse - 1)
    low = np.floor(position).astype(np.int64)
    return low, np.minimum(low + 1, coarse - 1), (position - low).astype(np.float32)


def pick(plane: npt.NDArray[Any], rows: Indices, columns: Indices, into: Float32) -> None:
    """Fill (h, w) with rows and columns of a plane, by slices of consecutive indices: far faster than by index."""
    across = _runs(columns)
    for rows_into, rows_from in _runs(rows):
        for columns_into, columns_from in across:
            into[rows_into, columns_into] = plane[rows_from, columns_from]


def _runs(index: Indices) -> list[tuple[slice, slice]]:
    """Divide indices into runs that rise or fall by one: slices of each run's positions and of its values."""
    runs, start = [], 0
    steps = np.diff(index)
    while start < len(index):
        step = int(steps[start]) if start < len(steps) and abs(steps[start]) == 1 else 1
        turns = np.flatnonzero(steps[start:] != step)
        stop = start + int(turns[0]) + 1 if len(turns) else len(index)
        first, beyond = int(index[start]), int(index[stop - 1]) + step
        runs.append((slice(start, stop), slice(first, beyond if beyond >= 0 else None, step)))
        start = stop
    return runs
