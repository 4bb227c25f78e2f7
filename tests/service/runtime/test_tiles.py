"""Any tiling gives what the whole gives."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from service.errors import NumericFault
from service.runtime.networks import Engine, Network, RuntimeName, open_network
from service.runtime.tiles import Tile, run_tiles, tiles
from tests.service.runtime.toynets import toy_net, write_models

Float = npt.NDArray[np.float32]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    models = {
        "plain": toy_net("plain", ["a", "b"], ["x", "y", "z"]),
        "tail": toy_net("tail", ["a", "b"], ["x"], scale=4),
        "short": toy_net("short", ["a", "b"], ["x"], margin=2),
        "whole": toy_net("whole", ["a", "b"], ["x"], whole=(24, 16)),
    }
    return write_models(tmp_path_factory.mktemp("models"), models)


@pytest.fixture(scope="module")
def plain(folder: Path) -> Iterator[Network]:
    with open_network("plain", Engine(threads=1, folder=folder)) as network:
        yield network


def image(height: int, width: int) -> Float:
    return np.random.default_rng(2).uniform(-1, 1, (2, height, width)).astype(np.float32)


def tiled(network: Network, maps: Float, tile: int) -> Float:
    """The result, its untouched places marked with 99."""
    scale = network.description.scale
    shape = (len(network.description.outputs), maps.shape[1] * scale, maps.shape[2] * scale)
    result = np.full(shape, 99, np.float32)

    def write(one: Tile, part: Float) -> None:
        result[:, *one.scaled(scale)] = part

    size = (maps.shape[2], maps.shape[1])
    run_tiles(network, lambda rows, columns: maps[:, rows][:, :, columns], size, write, tile=tile)
    return result


def untiled(network: Network, maps: Float) -> Float:
    """The definition: the map with its mirror image around it, computed at once, by numpy's own padding."""
    what = network.description
    odd = [-side % what.stride for side in maps.shape[1:]]
    pads = [(0, 0), *((what.margin, what.margin + more) for more in odd)]
    result = network.run(np.pad(maps, pads, "reflect"))
    tall, wide = (side * what.scale for side in maps.shape[1:])
    return result[:, :tall, :wide]


@pytest.mark.parametrize("name", ["plain", "tail"])
@pytest.mark.parametrize("tile", [16, 30, 50, 1000])
def test_every_tile_size_gives_the_whole(folder: Path, name: str, tile: int) -> None:
    """A margin too small, an origin off the stride, or zeros instead of the mirror image at the border show here."""
    maps = image(61, 83)
    with open_network(name, Engine(threads=1, folder=folder)) as network:
        np.testing.assert_allclose(tiled(network, maps, tile), untiled(network, maps), atol=1e-5)


def test_a_margin_shorter_than_the_reach_would_show(folder: Path) -> None:
    """The test above can fail: with a margin of 2 where the network looks further, tiles differ from the whole."""
    maps = image(64, 64)
    with open_network("short", Engine(threads=1, folder=folder)) as network:
        assert np.abs(tiled(network, maps, 16) - tiled(network, maps, 64)).max() > 1e-3


def test_tiles_lie_around_marks_alone(plain: Network) -> None:
    """Where a mark is, or the texel beside it that interpolation reaches, the result is the whole's; far away none."""
    maps, where = image(64, 96), np.zeros((8, 12), bool)
    where[4, 5:7] = True
    result = np.full((3, 64, 96), 99, np.float32)

    def write(one: Tile, part: Float) -> None:
        result[:, *one.scaled(1)] = part

    run_tiles(plain, lambda rows, columns: maps[:, rows][:, :, columns], (96, 64), write, tile=16, where=where)
    near = np.s_[:, 24:48, 32:64]
    np.testing.assert_allclose(result[near], untiled(plain, maps)[near], atol=1e-5)
    assert (result[:, :16] == 99).all() and (result[:, :, :24] == 99).all() and (result[:, :, 72:] == 99).all()
    assert tiles(96, 64, 16, 8, np.zeros((8, 12), bool)) == []


@pytest.mark.parametrize("runtime", ["onnxruntime", "openvino"])
def test_tiles_computed_at_once_are_those_computed_alone(folder: Path, runtime: RuntimeName) -> None:
    maps = image(120, 160)
    found = []
    for threads in (1, 2):
        with open_network("plain", Engine(runtime, threads=threads, folder=folder)) as network:
            assert network.lanes == threads
            found.append(tiled(network, maps, 16))
    np.testing.assert_allclose(found[0], found[1], atol=1e-6)
    with open_network("whole", Engine(runtime, threads=2, folder=folder)) as network:
        assert network.lanes == 1


def test_nan_in_one_tile_is_named_by_channel(plain: Network) -> None:
    maps = image(40, 40)
    maps[1, 30, 30] = np.nan
    with pytest.raises(NumericFault, match="plain: input b has"):
        tiled(plain, maps, 16)


def test_a_failing_reader_or_writer_is_heard(plain: Network) -> None:
    """They run in other threads, where an exception must not vanish; nor that of the last tile, after which nothing
    else is waited for.
    """
    maps = image(40, 40)

    def read(rows: npt.NDArray[np.int64], columns: npt.NDArray[np.int64]) -> Float:
        raise KeyError("no such channel")

    def write(one: Tile, part: Float) -> None:
        if one.bottom == one.right == 40:
            raise OSError("no space")

    with pytest.raises(KeyError, match="no such channel"):
        run_tiles(plain, read, (40, 40), lambda t, x: None)
    for tile in (16, 64):
        with pytest.raises(OSError, match="no space"):
            run_tiles(plain, lambda rows, columns: maps[:, rows][:, :, columns], (40, 40), write, tile=tile)
