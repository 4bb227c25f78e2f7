"""Networks over the whole map: one that enlarges the texture, and those that translate it, whose results count on skin.

Translated in tiles are the specular albedo, by psi, and the tangent-space normals for specular and for diffuse
reflection, by rho and sigma (AvatarMe, section 4.3). zeta is super-resolution of the texture of 576 x 384 by a factor
of 8 (section 4.2; RCAN, Zhang et al. 2018): channel attention averages over the whole map, so the body of the network
runs on the map at once; the upsampling tail has a receptive field of a few texels and runs in tiles. It gives what is
added to a bicubic enlargement.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from service.arrays import Bool, Float32, UInt8
from service.colour import Codes, from_codes, to_codes
from service.errors import ModelFault
from service.image_filters import STRIP, shrunk, strips
from service.reflectance.planes import Planes
from service.reflectance.reflectance_maps import pack_slopes
from service.runtime.network_registry import COVERED, NOISE, networks_of
from service.runtime.networks import Engine, Network, open_network
from service.runtime.tiles import DEFAULT_TILE, Tile, run_tiles, run_whole


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


@contextmanager
def open_translator(name: str, engine: Engine, outputs: int) -> Iterator[Network]:
    """Network ``name`` for :func:`translate`, for the length of a ``with`` block.

    Raises:
        ModelFault: it does not have ``outputs`` planes at the size of its input, or cannot be loaded.
    """
    with open_network(name, engine) as network:
        what = network.description
        if len(what.outputs) != outputs or what.scale != 1:
            raise ModelFault(
                f"network {name} gives {len(what.outputs)} planes at {what.scale} times the size; "
                f"it has to give {outputs} at the same size"
            )
        yield network


def translate(network: Network, job: MapInputs, keep: Keep, where: Bool | None = None) -> None:
    """Run a network in tiles and pass each result to ``keep``, a few rows at a time.

    Tiles lie around the marks of ``where`` (h, w) alone, a coarser map of the chart; None: everywhere.

    Raises:
        ModelFault: the network reads a channel that does not exist.
    """

    def write(one: Tile, values: Float32) -> None:
        for part in strips(one.bottom - one.top, STRIP):
            place = (slice(one.top + part.start, one.top + part.stop), slice(one.left, one.right))
            keep(place, values[:, part], job.skin[place] * np.float32(1 / 255))

    read = job.planes.read(network.description.channels)
    run_tiles(network, read, job.planes.size, write, tile=job.tile, where=where, progress=job.progress)


ELSEWHERE = 0.65
"""Specular albedo of eyes, teeth and tongue: F0 = 0.04 * 0.65 = 0.026, that of water and the cornea (index 1.38)."""


def specular_albedo(job: MapInputs) -> Codes:
    """(H, W) codes, linear; ``ELSEWHERE`` off the skin. The job's planes hold ``albedo_*``.

    Raises:
        ModelFault: the network is missing, changed, or does not fit.
    """
    result = np.zeros(job.skin.shape, np.uint16)
    elsewhere = np.float32(2 * ELSEWHERE - 1)

    def keep(place: tuple[slice, slice], values: Float32, skin: Float32) -> None:
        result[place] = to_codes(elsewhere + skin * (np.clip(values[0], -1, 1) - elsewhere))

    with open_translator(networks_of("specular_albedo")[-1], job.engine, 1) as psi:
        translate(psi, job, keep)
    return result


def tangent_normals(stage: str, job: MapInputs) -> npt.NDArray[np.int16]:
    """(H, W, 2) int16 codes of x and y from the network of a stage; flat off the skin and where the skin is covered.

    The networks read relief off bare skin, and give the likeliest: where colour and shade tell little, little of it
    (``models.training.real_skins``). Strands of hair, brows and frames of glasses are dark lines as creases are,
    and what lies under them is not seen: there the map is flat.

    Args:
        stage: "specular_normal" or "diffuse_normal".
        job: inputs of the network; without a channel ``COVERED`` all skin is bare.

    Raises:
        ModelFault: the network is missing, changed, or does not fit.
    """
    result = np.zeros((*job.skin.shape, 2), np.int16)
    covered, where = None, None
    if COVERED in job.planes.channels:
        covered = job.planes.read([COVERED])
        size = (max(job.planes.size[0] // MARKS, 1), max(job.planes.size[1] // MARKS, 1))
        where = (job.planes.shrunk([COVERED], size)[0] < 1) & (shrunk(job.skin, size) > 0)

    def keep(place: tuple[slice, slice], values: Float32, skin: Float32) -> None:
        bare = skin
        if covered is not None:
            rows, columns = (np.arange(s.start, s.stop) for s in place)
            bare = skin * (1 - np.clip(covered(rows, columns)[0], 0, 1))
        result[place] = pack_slopes(bare * values[0], bare * values[1])

    with open_translator(networks_of(stage)[-1], job.engine, 2) as network:
        translate(network, job, keep, where)
    return result


MARKS = 16
"""Texels of a side of a mark of bare skin: no tile of a network lies where there is none."""


BODY, TAIL = networks_of("super_resolution")

BODY_SHARE = 0.5
"""Share of the body in the time of both networks, for reports of progress."""

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Grain:
    """Noise that the networks turn into synthetic detail: its seed, and its standard deviation in [0, 1]."""

    seed: int = 0
    strength: float = 1.0


def enlarge(
    texture: Codes, planes: Planes, grain: Grain, engine: Engine, tile: int, progress: Progress = lambda done: None
) -> Codes:
    """(8 H, 8 W, 3) codes of a texture (H, W, 3); the factor 8 is the network's.

    A texel of the texture covers dozens of pores that it does not show. A network with channels ``noise_*`` synthesises
    them from that noise: normally distributed, the same for the same seed. With strength 0 the result is the network's
    smooth, most likely texture.

    Args:
        texture: codes, of the size that the networks were made for.
        planes: ``texture_*`` and geometry of that size.
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
        result = resample(texture, (width * scale, height * scale))

        def write(one: Tile, values: Float32) -> None:
            part = result[one.scaled(scale)]
            part[:] = to_codes(from_codes(part) + np.moveaxis(values, 0, 2))

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
