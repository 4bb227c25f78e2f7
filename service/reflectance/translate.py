"""One network over the whole map, its result kept where it learnt to speak and replaced elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.errors import ModelFault
from service.reflectance.planes import Planes
from service.runtime.networks import Engine, open_network
from service.runtime.tiles import DEFAULT_TILE, Tile, run_tiles

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class MapInputs:
    """What every translator is given.

    Attributes:
        planes: channels to read.
        skin: (H, W) uint8, 255 where the networks' word counts, 0 where it does not.
        engine: what to run on.
        tile: inner side of tiles in texels.
        progress: told the share of the stage that is done.
    """

    planes: Planes
    skin: Mask
    engine: Engine
    tile: int = DEFAULT_TILE
    progress: Callable[[float], None] = lambda done: None


Keep = Callable[[tuple[slice, slice], Float, Float], None]
"""Rows and columns, the result (K, h, w), and how far it counts (h, w) in [0, 1]."""


def translate(name: str, job: MapInputs, outputs: int, keep: Keep) -> None:
    """Run network ``name`` in tiles and hand each result to ``keep``.

    Raises:
        ModelFault: the network has another number of outputs than ``outputs``, wants a channel that is not there, or
            cannot be loaded.
    """
    with open_network(name, job.engine) as network:
        what = network.description
        if len(what.outputs) != outputs or what.scale != 1:
            raise ModelFault(
                f"network {name} gives {len(what.outputs)} planes at {what.scale} times the size; "
                f"it has to give {outputs} at the same size"
            )

        def write(one: Tile, values: Float) -> None:
            place = one.scaled(1)
            keep(place, values, job.skin[place] * np.float32(1 / 255))

        read = job.planes.read(what.channels)
        run_tiles(network, read, job.planes.size, write, tile=job.tile, progress=job.progress)
