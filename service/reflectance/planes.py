"""Channels by name: the inputs of the networks, wherever they are kept.

A channel is a full-size map of codes, a full-size float array, or a coarse field that is interpolated. Every kind gives
the value at a texel from that texel's place on the whole chart alone, so it does not matter in which tile it is read.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from service.colour import LUMA
from service.errors import ModelFault
from service.runtime.tiles import Indices

Float = npt.NDArray[np.float32]
Codes = npt.NDArray[np.uint16]

FULL_CODE = 65535
"""Colours between stages are 16-bit codes: 8 bits would drown pores, and floats take twice the memory."""

Read = Callable[[Indices, Indices], Float]
"""Rows (h,) and columns (w,) -> (h, w) float32."""


@dataclass(frozen=True)
class Channel:
    """One plane.

    Attributes:
        read: values at texels of the map.
        shrunk: (width, height) -> (height, width) float32, averaged over each texel's area where that is larger.
    """

    read: Read
    shrunk: Callable[[tuple[int, int]], Float]


def to_codes(values: Float) -> Codes:
    """Values in [-1, 1] as codes 0 to 65535; what lies outside is clipped."""
    return np.asarray(np.rint((np.clip(values, -1, 1) + 1) * np.float32(FULL_CODE / 2)), np.uint16)


def from_codes(codes: Codes) -> Float:
    """Inverse of :func:`to_codes`: float32 in [-1, 1]."""
    return codes * np.float32(2 / FULL_CODE) - np.float32(1)


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
        """Channels ``name_r``, ``name_g``, ``name_b`` in [-1, 1] of (H, W, 3) codes, and ``name_grey``, their luma."""
        for index, letter in enumerate("rgb"):
            plane = codes[..., index]
            self.channels[f"{name}_{letter}"] = Channel(
                lambda rows, columns, plane=plane: from_codes(_pick(plane, rows, columns)),  # type: ignore[misc]
                lambda size, plane=plane: from_codes(_resized(plane, size)),  # type: ignore[misc]
            )
        self.channels[f"{name}_grey"] = Channel(
            lambda rows, columns: from_codes(_pick(codes, rows, columns)) @ LUMA,
            lambda size: from_codes(_resized(codes, size)) @ LUMA,
        )

    def add_full(self, names: Sequence[str], values: npt.NDArray[np.floating]) -> None:
        """Channels of a (C, H, W) array as they are."""
        for name, plane in zip(names, np.asarray(values, np.float32), strict=True):
            self.channels[name] = Channel(
                lambda rows, columns, plane=plane: _pick(plane, rows, columns),  # type: ignore[misc]
                lambda size, plane=plane: _resized(plane, size),  # type: ignore[misc]
            )

    def add_coarse(self, names: Sequence[str], values: Float) -> None:
        """Channels of a (C, h, w) array that covers the same chart, interpolated between its texels' centres."""
        for name, plane in zip(names, values, strict=True):
            self.channels[name] = Channel(
                lambda rows, columns, plane=plane: interpolated(plane, self.size, rows, columns),  # type: ignore[misc]
                lambda size, plane=plane: _resized(plane, size),  # type: ignore[misc]
            )

    def drop(self, name: str) -> None:
        """Forget the channels of :meth:`add_codes`, so that their memory can go."""
        for suffix in ("r", "g", "b", "grey"):
            self.channels.pop(f"{name}_{suffix}", None)

    def read(self, names: Sequence[str]) -> Callable[[Indices, Indices], Float]:
        """Reader of several channels -> (C, h, w).

        Raises:
            ModelFault: a channel is not there; the message lists those that are.
        """
        chosen = self._chosen(names)
        return lambda rows, columns: np.stack([channel.read(rows, columns) for channel in chosen])

    def shrunk(self, names: Sequence[str], size: tuple[int, int]) -> Float:
        """(C, height, width) of channels averaged over the area of each texel of a map of ``size`` (width, height)."""
        return np.stack([channel.shrunk(size) for channel in self._chosen(names)])

    def _chosen(self, names: Sequence[str]) -> list[Channel]:
        missing = [name for name in names if name not in self.channels]
        if missing:
            raise ModelFault(f"no channel {missing[0]!r} for a network; there are {', '.join(sorted(self.channels))}")
        return [self.channels[name] for name in names]


def interpolated(plane: Float, size: tuple[int, int], rows: Indices, columns: Indices) -> Float:
    """(len(rows), len(columns)) values of a coarse (h, w) plane at texels of the same chart at ``size``."""
    tall, wide = size[1] / plane.shape[0], size[0] / plane.shape[1]
    if not (tall.is_integer() and wide.is_integer()) or not (len(rows) and len(columns)):
        return _interpolated_anywhere(plane, size, rows, columns)
    block, first_row, first_column = _enlarged_block(plane, int(tall), int(wide), rows, columns)
    return np.ascontiguousarray(_pick(block, rows - first_row, columns - first_column))


def _enlarged_block(plane: Float, tall: int, wide: int, rows: Indices, columns: Indices) -> tuple[Float, int, int]:
    """The part of the plane around some texels, enlarged by whole factors, and the texel of its corner.

    OpenCV is several times as fast as indexing; a coarse texel more at each side keeps its border out of the result.
    """
    import cv2

    top, bottom = max(int(rows.min()) // tall - 1, 0), min(int(rows.max()) // tall + 2, plane.shape[0])
    left, right = max(int(columns.min()) // wide - 1, 0), min(int(columns.max()) // wide + 2, plane.shape[1])
    part = np.ascontiguousarray(plane[top:bottom, left:right])
    size = ((right - left) * wide, (bottom - top) * tall)
    return np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_LINEAR)), top * tall, left * wide


def _interpolated_anywhere(plane: Float, size: tuple[int, int], rows: Indices, columns: Indices) -> Float:
    """The same for any ratio of sizes."""
    above, below, down = _between(plane.shape[0], size[1], rows)
    left, right, across = _between(plane.shape[1], size[0], columns)
    lines = plane[:, left] * (1 - across) + plane[:, right] * across
    result: Float = lines[above] * (1 - down[:, None])
    result += lines[below] * down[:, None]
    return result


def _between(coarse: int, fine: int, index: Indices) -> tuple[Indices, Indices, Float]:
    """The two coarse texels around the centre of each fine one, and the weight of the second."""
    position = np.clip((index + 0.5) * (coarse / fine) - 0.5, 0, coarse - 1)
    low = np.floor(position).astype(np.int64)
    return low, np.minimum(low + 1, coarse - 1), (position - low).astype(np.float32)


def _pick(plane: npt.NDArray[Any], rows: Indices, columns: Indices) -> npt.NDArray[Any]:
    """Rows and columns of (H, W, ...); a view where they run on without a turn."""
    if len(rows) and len(columns) and _runs(rows) and _runs(columns):
        return plane[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return plane[np.ix_(rows, columns)]


def _runs(index: Indices) -> bool:
    return bool((np.diff(index) == 1).all())


def _resized(plane: npt.NDArray[Any], size: tuple[int, int]) -> npt.NDArray[Any]:
    """(height, width, ...) by area where the result is smaller, else linearly."""
    import cv2

    way = cv2.INTER_AREA if size[0] <= plane.shape[1] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(np.ascontiguousarray(plane), size, interpolation=way))
