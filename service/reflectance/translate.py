"""Run one image-to-image network over the whole map, in tiles; its result counts on skin only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from service.arrays import Float32, UInt8
from service.errors import ModelFault
from service.reflectance.planes import Planes
from service.runtime.networks import Engine, open_network
from service.runtime.tiles import DEFAULT_TILE, Tile, run_tiles


@dataclass(frozen=True)
class MapInputs:
    """Inputs that all networks of the reflectance stages share.

    Attributes:
        planes: channels to read.
        skin: (H, W) uint8 weight of the networks' results, 255 where they count, 0 where they do not.
        engine: what to run on.
        tile: inner side of tiles in texels.
        progress: called with the share of the stage that is done.
    """

    planes: Planes
    skin: UInt8
    engine: Engine
    tile: int = DEFAULT_TILE
    progress: Callable[[float], None] = lambda done: None


Keep = Callable[[tuple[slice, slice], Float32, Float32], None]
"""Function of slices of rows and columns, the result (K, h, w) there, and its weight (h, w) in [0, 1]."""


def translate(name: str, job: MapInputs, outputs: int, keep: Keep) -> None:
    """Run network ``name`` in tiles and pass each result to ``keep``.

    Raises:
        ModelFault: the network does not have ``outputs`` planes at the size of its input, reads a channel that does not
            exist, or cannot be loaded.
    """
    with open_network(name, job.engine) as network:
        what = network.description
        if len(what.outputs) != outputs or what.scale != 1:
            raise ModelFault(
                f"network {name} gives {len(what.outputs)} planes at {what.scale} times the size; "
                f"it has to give {outputs} at the same size"
            )

        def write(one: Tile, values: Float32) -> None:
            place = one.scaled(1)
            keep(place, values, job.skin[place] * np.float32(1 / 255))

        read = job.planes.read(what.channels)
        run_tiles(network, read, job.planes.size, write, tile=job.tile, progress=job.progress)
