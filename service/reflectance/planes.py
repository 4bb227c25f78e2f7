"""Input channels of the networks, by name, however they are stored.

A channel is a full-size map of codes, a full-size float array, or a coarse field that is interpolated. Its value at a
texel depends on the texel's position on the whole chart only, and not on the tile in which it is read: it is picked
from a plane of the map's size, or interpolated from a coarser plane of the same chart.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from math import gcd
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from service.arrays import AnyFloat, Float32
from service.colour import FULL_CODE, LUMA, Codes, decode_in_place, from_codes
from service.errors import ModelFault
from service.image_filters import resized
from service.runtime.network_registry import FINE, FINE_GAIN, FINE_WINDOW, PACKED
from service.runtime.tiles import Indices


def read_window(
    planes: Sequence[Float32] | Float32, size: tuple[int, int], rows: slice, columns: slice | None = None
) -> Float32:
    """(h, w, C) float32 of coarse planes of one size (h', w') at rows and columns of a map of ``size``."""
    across = slice(0, size[0]) if columns is None else columns
    near = _window(planes[0].shape, size, (rows.start, rows.stop), (across.start, across.stop))
    if near is None:
        down, beside = np.r_[rows], np.r_[across]
        return np.stack([_interpolated_anywhere(plane, size, down, beside) for plane in planes], -1)
    (top, bottom, first_row, tall), (left, right, first_column, wide) = near
    # Interpolated together, channel beside channel, as the codes lie that they change.
    part = cv2.merge([np.ascontiguousarray(plane[top:bottom, left:right]) for plane in planes])
    found = cv2.resize(part, (wide, tall), interpolation=cv2.INTER_LINEAR).reshape(tall, wide, len(planes))
    inside = slice(across.start - first_column, across.stop - first_column)
    return np.asarray(found[rows.start - first_row : rows.stop - first_row, inside], np.float32)


def interpolate_into(plane: Float32, size: tuple[int, int], rows: Indices, columns: Indices, into: Float32) -> None:
    """Write bilinear values of a coarse (h, w) plane at texels of a map of ``size`` (width, height), on the same chart,
    into a plane (len(rows), len(columns)).
    """
    ends = [(int(index.min()), int(index.max()) + 1) if len(index) else (0, 0) for index in (rows, columns)]
    near = _window(plane.shape, size, *ends)
    if near is None:
        into[...] = _interpolated_anywhere(plane, size, rows, columns)
        return
    (top, bottom, first_row, tall), (left, right, first_column, wide) = near
    part = np.ascontiguousarray(plane[top:bottom, left:right])
    pick(cv2.resize(part, (wide, tall), interpolation=cv2.INTER_LINEAR), rows - first_row, columns - first_column, into)


MOST_PERIOD = 8
"""Coarse texels after which their borders meet those of the map's texels again, up to which OpenCV interpolates."""


Ends = tuple[int, int]
"""First texel of a line, and the one after the last."""
Near = tuple[int, int, int, int]
"""First coarse texel and the one after the last around texels of a map, first texel of the map that they cover, and how
many they cover."""


def _window(coarse: tuple[int, ...], size: tuple[int, int], rows: Ends, columns: Ends) -> tuple[Near, Near] | None:
    """What to enlarge for rows and columns of a map; None where there are none, or their borders do not meet."""
    periods = [small // gcd(small, fine) for small, fine in zip(coarse, size[::-1], strict=True)]
    if max(periods) > MOST_PERIOD or rows[0] >= rows[1] or columns[0] >= columns[1]:
        return None
    return _around(rows, size[1], coarse[0], periods[0]), _around(columns, size[0], coarse[1], periods[1])


def _around(ends: Ends, fine: int, coarse: int, period: int) -> Near:
    """Of a line of ``fine`` texels of the map that has ``coarse`` ones.

    OpenCV is several times as fast as indexing. One more coarse texel on each side keeps its border handling out of the
    result; and their borders are borders of texels of the map.
    """
    low = max(ends[0] * coarse // fine - 1, 0) // period * period
    high = min(-(-((ends[1] - 1) * coarse // fine + 2) // period) * period, coarse)
    start = low * fine // coarse
    return low, high, start, high * fine // coarse - start


def _interpolated_anywhere(plane: Float32, size: tuple[int, int], rows: Indices, columns: Indices) -> Float32:
    """As :func:`interpolate_into`, for any ratio of sizes."""
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
    down, across = (_runs(np.asarray(index, np.int64).tobytes()) for index in (rows, columns))
    for rows_into, rows_from in down:
        for columns_into, columns_from in across:
            into[rows_into, columns_into] = plane[rows_from, columns_from]


@lru_cache(maxsize=64)
def _runs(indices: bytes) -> tuple[tuple[slice, slice], ...]:
    """Divide indices (int64) into runs that rise or fall by one: slices of each run's positions and of its values.

    Kept, as all channels of a tile are read at the same indices.
    """
    index = np.frombuffer(indices, np.int64)
    runs, start = [], 0
    steps = np.diff(index)
    while start < len(index):
        step = int(steps[start]) if start < len(steps) and abs(steps[start]) == 1 else 1
        turns = np.flatnonzero(steps[start:] != step)
        stop = start + int(turns[0]) + 1 if len(turns) else len(index)
        first, beyond = int(index[start]), int(index[stop - 1]) + step
        runs.append((slice(start, stop), slice(first, beyond if beyond >= 0 else None, step)))
        start = stop
    return tuple(runs)


Read = Callable[[Indices, Indices, Float32], None]
"""Function of rows (h,), columns (w,) and the (h, w) float32 plane that it fills with their values."""


@dataclass(frozen=True)
class Channel:
    """One input plane of a network.

    Attributes:
        read: fills a plane with values at texels of the map.
        shrunk: function (width, height) -> (height, width) float32: the channel resized, by area where that is smaller.
        coarse: (h, w) what it is interpolated from; None: nothing.
    """

    read: Read
    shrunk: Callable[[tuple[int, int]], Float32]
    coarse: Float32 | None = None


@dataclass
class Planes:
    """All channels of a map of (width, height) texels.

    Attributes:
        size: (width, height).
        channels: reader of each channel by name.
    """

    size: tuple[int, int]
    channels: dict[str, Channel] = field(default_factory=dict)

    def add_codes(self, name: str, codes: Codes) -> None:
        """Add ``name_r``, ``name_g``, ``name_b`` in [-1, 1] from (H, W, 3) codes, and ``name_grey``, their luma."""
        planes = [codes[..., index] for index in range(3)]
        for letter, plane in zip("rgb", planes, strict=True):
            self.channels[f"{name}_{letter}"] = Channel(
                lambda rows, columns, into, plane=plane: _read_codes(plane, rows, columns, into),  # type: ignore[misc]
                lambda size, plane=plane: from_codes(resized(plane, size)),  # type: ignore[misc]
            )
        self.channels[f"{name}_grey"] = Channel(
            lambda rows, columns, into: _read_grey(planes, rows, columns, into),
            lambda size: from_codes(resized(codes, size)) @ LUMA,
        )

    def add_grey(self, name: str, codes: Codes) -> None:
        """Add one channel in [-1, 1] from (H, W) codes."""
        self.channels[name] = Channel(
            lambda rows, columns, into: _read_codes(codes, rows, columns, into),
            lambda size: from_codes(resized(codes, size)),
        )

    def add_fine(self, name: str) -> None:
        """Add one of ``FINE``, of a grey that is there."""
        grey = self.channels[FINE[name]]

        def read(rows: Indices, columns: Indices, into: Float32) -> None:
            grey.read(rows, columns, into)
            into[...] = _fine(into)

        self.channels[name] = Channel(read, lambda size: _fine(grey.shrunk(size)))

    def add_full(self, names: Sequence[str], values: AnyFloat) -> None:
        """Add the channels of a (C, H, W) array, unchanged but for float32."""
        for name, plane in zip(names, np.asarray(values, np.float32), strict=True):
            self.channels[name] = Channel(
                lambda rows, columns, into, plane=plane: pick(plane, rows, columns, into),  # type: ignore[misc]
                lambda size, plane=plane: resized(plane, size),  # type: ignore[misc]
            )

    def add_coarse(self, names: Sequence[str], values: Float32) -> None:
        """Add the channels of a coarser (C, h, w) array on the same chart, interpolated between its texels' centres."""
        size = self.size  # channels that knew this object would keep it, and all its planes, until a collection
        for name, plane in zip(names, values, strict=True):
            self.channels[name] = Channel(
                lambda rows, columns, into, plane=plane: interpolate_into(plane, size, rows, columns, into),  # type: ignore[misc]
                lambda size, plane=plane: resized(plane, size),  # type: ignore[misc]
                plane,
            )

    def coarse_at(self, size: tuple[int, int]) -> Planes:
        """Those channels that are interpolated, for a map of another ``size`` (width, height)."""
        result = Planes(size)
        for name, channel in self.channels.items():
            if channel.coarse is not None:
                result.add_coarse([name], channel.coarse[None])
        return result

    def drop(self, name: str) -> None:
        """Remove the channels of :meth:`add_codes`, so that their memory can be freed."""
        for suffix in ("r", "g", "b", "grey"):
            self.channels.pop(f"{name}_{suffix}", None)

    def read(self, names: Sequence[str]) -> Callable[[Indices, Indices], Float32]:
        """Function of rows (h,) and columns (w,) that gives the (C, h, w) float32 values of several channels.

        Raises:
            ModelFault: a channel does not exist, where the message lists those that do, or cannot be packed.
        """
        readers = [
            self._chosen([name])[0].read if PACKED not in name else self._packed(name.split(PACKED)) for name in names
        ]

        def read(rows: Indices, columns: Indices) -> Float32:
            planes = np.zeros((len(readers), len(rows), len(columns)), np.float32)
            for fill, plane in zip(readers, planes, strict=True):
                fill(rows, columns, plane)
            return planes

        return read

    def shrunk(self, names: Sequence[str], size: tuple[int, int]) -> Float32:
        """(C, height, width) float32 channels resized to ``size`` (width, height), by area where that is smaller."""
        return np.stack([channel.shrunk(size) for channel in self._chosen(names)])

    def _packed(self, names: Sequence[str]) -> Read:
        coarse = [channel.coarse for channel in self._chosen(names)]
        planes = [plane for plane in coarse if plane is not None]
        if len(planes) < len(names):
            raise ModelFault(f"{PACKED.join(names)}: only what is interpolated comes packed")
        wide, tall = (-(-side // 2) for side in self.size)

        def read(rows: Indices, columns: Indices, into: Float32) -> None:
            down, across = rows[::2] // 2, columns[::2] // 2
            for k, plane in enumerate(planes):
                interpolate_into(plane, (wide, tall), down, across, into[k // 2 :: 2, k % 2 :: 2])

        return read

    def _chosen(self, names: Sequence[str]) -> list[Channel]:
        missing = [name for name in names if name not in self.channels]
        if missing:
            there = ", ".join(sorted(self.channels))
            raise ModelFault(f"no channel {missing[0]!r}, which a network reads; there are {there}")
        return [self.channels[name] for name in names]


def _fine(grey: Float32) -> Float32:
    mean = cv2.blur(grey, (FINE_WINDOW, FINE_WINDOW))
    return np.asarray(cv2.addWeighted(grey, FINE_GAIN, mean, -FINE_GAIN, 0), np.float32)


def _read_codes(plane: Codes, rows: Indices, columns: Indices, into: Float32) -> None:
    pick(plane, rows, columns, into)
    decode_in_place(into)


def _read_grey(planes: Sequence[Codes], rows: Indices, columns: Indices, into: Float32) -> None:
    into[...] = -1
    one = np.zeros_like(into)
    for plane, share in zip(planes, LUMA, strict=True):
        pick(plane, rows, columns, one)
        one *= np.float32(share * 2 / FULL_CODE)
        into += one
