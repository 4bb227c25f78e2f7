"""A network over a map of any size, in tiles whose result is that of the whole.

A tile is read with a margin about as wide as the network looks, of which the result is without, so no pixel knows about
tiles. At the border of the map the margin is the map's own mirror image, also where there is only one tile.
Tile origins are multiples of the network's stride, because down-sampling makes a network's output depend on that phase.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.arrays import Bool, Float32
from service.errors import ModelFault
from service.image_filters import marked_columns
from service.runtime.networks import Description, Network
from service.runtime.sessions import prompt_release

Indices = npt.NDArray[np.int64]

Read = Callable[[Indices, Indices], Float32]
"""Rows (h,) and columns (w,) of the map, each within it but in any order -> (C, h, w) float32."""

DEFAULT_TILE = 768
"""Inner side of a tile in input pixels: two of them at once take half a gigabyte. Of 1024, networks would compute an
eighth fewer texels, and a standard head would take 100 MB more."""

SMALL_TILE = 512
"""For a machine that has too little memory: margins cost half of the time there."""


@dataclass(frozen=True)
class Tile:
    """A rectangle of the map in input pixels: rows ``top`` to ``bottom`` - 1, columns ``left`` to ``right`` - 1."""

    top: int
    left: int
    bottom: int
    right: int

    def scaled(self, scale: int) -> tuple[slice, slice]:
        """Where the rectangle lies in the output."""
        return slice(self.top * scale, self.bottom * scale), slice(self.left * scale, self.right * scale)


SMALL_MAP = 1536 * 1024
"""Texels of a map up to which memory is no matter: stages run side by side, and what one leaves is kept for the next,
as fresh pages took a tenth of a draft."""


Write = Callable[[Tile, Float32], None]
"""Takes a tile and its result (K, scale h, scale w)."""


def tiles(width: int, height: int, tile: int, stride: int, where: Bool | None = None) -> list[Tile]:
    """Cut a map into tiles of nearly equal size, at most ``tile`` rounded up to ``stride``, row by row.

    Args:
        width: of the map.
        height: of the map.
        tile: inner side.
        stride: of which origins are multiples.
        where: (h, w) marks on a coarser map of the same chart: tiles lie around these alone; None: everywhere.

    Raises:
        ValueError: tile < 1 or an empty map.
    """
    marked = np.ones((1, 1), bool) if where is None else where
    found = []
    for top, bottom in _cuts(*_reach(np.asarray(marked.any(1)), height, stride), tile, stride):
        columns = marked_columns(marked, (width, height), slice(top, bottom), stride)
        if columns is not None:
            found += [Tile(top, left, bottom, right) for left, right in _cuts(*columns, tile, stride)]
    return found


def run_tiles(
    network: Network,
    read: Read,
    size: tuple[int, int],
    write: Write,
    *,
    tile: int = DEFAULT_TILE,
    where: Bool | None = None,
    progress: Callable[[float], None] = lambda done: None,
) -> None:
    """Compute a network over a map; memory does not grow with the map.

    Args:
        network: a loaded network that may be cut into tiles.
        read: gives the input of a tile. It and ``write`` run in several threads, for different tiles.
        size: (width, height) of the map in input pixels.
        write: takes each tile's result, in any order.
        tile: inner side of a tile in input pixels.
        where: (h, w) marks, as of :func:`tiles`; elsewhere nothing is computed nor written.
        progress: told the share that is done, in (0, 1], after each tile.

    Raises:
        ModelFault: the network takes whole maps of one size only, or fails.
        NumericFault: a value that goes in or comes out is NaN or Inf.
        ValueError: tile < 1 or an empty map.
    """
    what = network.description
    if what.whole is not None:
        raise ModelFault(f"network {network.name} takes whole maps of {what.whole}; it cannot run in tiles")
    todo = tiles(*size, tile, what.stride, where)

    def work(one: Tile) -> None:
        rows = reflected(size[1], *_window(one.top, one.bottom, what))
        columns = reflected(size[0], *_window(one.left, one.right, what))
        tall, wide = (one.bottom - one.top) * what.scale, (one.right - one.left) * what.scale
        write(one, network.run(read(rows, columns))[:, :tall, :wide])

    with ThreadPoolExecutor(network.lanes) as pool:
        for index, _ in enumerate(pool.map(work, todo)):
            progress((index + 1) / len(todo))
    network.large |= size[0] * size[1] > SMALL_MAP


def run_whole(network: Network, maps: Float32) -> Float32:
    """(K, ...) result of a network that takes one whole map (C, H, W) of the size that it names.

    Raises:
        ModelFault: the map has another size, or as :meth:`Network.run`.
        NumericFault: as :meth:`Network.run`.
    """
    whole = network.description.whole
    if whole is not None and maps.shape[:0:-1] != whole:
        raise ModelFault(f"network {network.name} takes maps of {whole}, not {maps.shape[:0:-1]}")
    with prompt_release():
        return network.run(maps)


def reflected(count: int, start: int, stop: int) -> Indices:
    """Indices ``start`` to ``stop`` - 1 of a line of ``count`` that goes on as its mirror image, edges not repeated."""
    period = max(2 * (count - 1), 1)
    index = np.arange(start, stop) % period
    return np.minimum(index, period - index) if count > 1 else np.zeros(stop - start, np.int64)


def _cuts(start: int, stop: int, tile: int, stride: int) -> list[tuple[int, int]]:
    if tile < 1 or stop <= start:
        raise ValueError(f"cannot cut {stop - start} pixels into tiles of {tile}")
    count = -(-(stop - start) // tile)
    step = -(-(stop - start) // (count * stride)) * stride
    return [(at, min(at + step, stop)) for at in range(start, stop, step)]


def _reach(marked: Bool, count: int, stride: int) -> tuple[int, int]:
    """First texel, on the stride, and texel after the last, of a line of ``count`` that coarser marks can reach."""
    where, across = np.flatnonzero(marked), count / len(marked)
    if count < 1 or not len(where):
        return 0, count
    return max(int((where[0] - 1) * across) // stride * stride, 0), min(math.ceil((where[-1] + 2) * across), count)


def _window(start: int, stop: int, what: Description) -> tuple[int, int]:
    return start - what.margin, start + -(-(stop - start) // what.stride) * what.stride + what.margin
