"""zeta: super-resolution of the texture of 576 x 384 by a factor of 8 (AvatarMe, section 4.2; RCAN, Zhang et al. 2018).

Channel attention averages over the whole map, so the body of the network runs on the map at once; the upsampling tail
has a receptive field of a few texels and runs in tiles.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from service.arrays import Float32
from service.colour import Codes, to_codes
from service.errors import ModelFault
from service.reflectance.planes import Planes
from service.runtime.network_registry import NOISE, networks_of
from service.runtime.networks import Engine, open_network
from service.runtime.tiles import Tile, run_tiles, run_whole

BODY, TAIL = networks_of("super_resolution")

BODY_SHARE = 0.5
"""Share of the body in the time of both networks, for reports of progress."""

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Grain:
    """Noise that the networks turn into synthetic detail: its seed, and its standard deviation in [0, 1]."""

    seed: int = 0
    strength: float = 1.0


def enlarge(planes: Planes, grain: Grain, engine: Engine, tile: int, progress: Progress = lambda done: None) -> Codes:
    """(8 H, 8 W, 3) codes of a texture of (H, W) texels; the factor 8 is the network's.

    A texel of the texture covers dozens of pores that it does not show. A network with channels ``noise_*`` synthesises
    them from that noise: normally distributed, the same for the same seed. With strength 0 the result is the network's
    smooth, most likely texture.

    Args:
        planes: ``texture_*`` and geometry, of the size that the networks were made for.
        grain: seed and strength of the noise.
        engine: what to run on.
        tile: inner side of tiles in texels of the result.
        progress: called with the share that is done.

    Raises:
        ModelFault: a network is missing, changed, or does not fit the texture.
    """
    width, height = planes.size
    with open_network(BODY, engine) as body:
        what = body.description
        add_noise(planes, what.channels, grain)
        features = run_whole(body, planes.shrunk(what.channels, planes.size))
    progress(BODY_SHARE)
    planes.add_full(what.planes(len(features)), features)
    with open_network(TAIL, engine) as tail:
        scale = tail.description.scale
        if len(tail.description.outputs) != 3:
            raise ModelFault(f"network {TAIL} gives {tail.description.outputs}; it has to give red, green and blue")
        add_noise(planes, tail.description.channels, grain)
        result = np.zeros((height * scale, width * scale, 3), np.uint16)

        def write(one: Tile, values: Float32) -> None:
            result[one.scaled(scale)] = np.moveaxis(to_codes(values), 0, 2)

        def told(done: float) -> None:
            progress(BODY_SHARE + (1 - BODY_SHARE) * done)

        read = planes.read(tail.description.channels)
        run_tiles(tail, read, (width, height), write, tile=max(tile // scale, 1), progress=told)
    return result


def add_noise(planes: Planes, channels: tuple[str, ...], grain: Grain) -> None:
    """Add those of ``channels`` that are noise and do not exist yet: normally distributed numbers from the seed."""
    names = [name for name in channels if name.startswith(NOISE) and name not in planes.channels]
    for name in names:
        # Keyed by name, so that a channel's numbers do not depend on which other channels exist.
        generator = np.random.Generator(np.random.Philox(key=[grain.seed, zlib.crc32(name.encode())]))
        width, height = planes.size
        planes.add_full([name], generator.standard_normal((1, height, width), np.float32) * np.float32(grain.strength))


def resample(texture: Codes, size: tuple[int, int]) -> Codes:
    """(height, width, 3) codes of a texture resized to ``size`` (width, height): by area down, bicubically up."""
    if texture.shape[1::-1] == size:
        return texture
    way = cv2.INTER_AREA if size[0] < texture.shape[1] else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(texture, size, interpolation=way), np.uint16)
