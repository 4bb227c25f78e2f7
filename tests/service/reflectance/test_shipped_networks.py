"""The networks in the box."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from service.bench.runs import degrees
from service.geometry.chart import Chart
from service.head.files import load_head
from service.head.regions import vertex_mask
from service.reflectance.subject import GEOMETRY_SIZE, Subject
from service.runtime.network_registry import CLUES, LIT, PACKED, SHOWN
from service.runtime.networks import Engine, has_bf16, open_network
from service.runtime.sessions import has_openvino
from tests.service.runtime.test_tiles import tiled, untiled

Float = npt.NDArray[np.float32]

TRANSLATORS = ("delta", "psi", "rho", "sigma")
ENGINE = Engine(threads=2)


def like_maps(channels: tuple[str, ...], height: int, width: int) -> Float:
    """Colour and geometry of about the real ranges: smooth fields with grain."""
    rng = np.random.default_rng(4)
    row, column = np.mgrid[:height, :width] / 90.0
    planes = [
        0.5 * np.sin(row + k) * np.cos(column * (1 + k % 3)) + 0.05 * rng.standard_normal((height, width))
        for k in range(len(channels))
    ]
    return np.asarray(planes, np.float32)


SEAM = 2 / 255 / 10
"""Of values in [-1, 1]: a tenth of an 8-bit step, in noise as strong as it gets."""


@pytest.mark.parametrize("name", TRANSLATORS)
def test_tiles_equal_the_whole(name: str) -> None:
    """A margin shorter than what the trained weights use, or a norm over the tile, would show as seams."""
    with open_network(name, ENGINE) as network:
        maps = like_maps(network.description.channels, 320, 440)
        whole = untiled(network, maps)
        assert np.abs(tiled(network, maps, 128) - whole).max() <= SEAM
        assert np.abs(tiled(network, maps, 256) - whole).max() <= SEAM


def degrees_apart(one: Float, other: Float) -> Float:
    """Angles between the normals of two maps of slopes (2, h, w)."""
    normals = [np.dstack([*slopes, np.ones_like(slopes[0])]) for slopes in (one, other)]
    units = [normal / np.linalg.norm(normal, axis=2, keepdims=True) for normal in normals]
    return np.asarray(degrees(*units), np.float32)


@pytest.mark.skipif(
    not (has_openvino() and has_bf16()), reason="bf16 needs OpenVINO and a processor with AMX or AVX-512 BF16"
)
@pytest.mark.parametrize("name", TRANSLATORS)
def test_bf16_is_near_fp32(name: str) -> None:
    """Normals within half a degree, other maps within 2/255; and tiles of bf16 equal its whole to 2/255."""
    half = Engine("openvino", "bf16", threads=2)
    with open_network(name, ENGINE) as network:
        maps = like_maps(network.description.channels, 320, 440)
        exact = untiled(network, maps)
    with open_network(name, half) as network:
        found = untiled(network, maps)
        assert np.abs(tiled(network, maps, 128) - found).max() <= 2 * 2 / 255
    if name in ("rho", "sigma"):
        assert degrees_apart(found, exact).mean() < 0.5
    else:
        assert np.abs(found - exact).mean() <= 2 * 2 / 255


@pytest.mark.skipif(not has_openvino(), reason="OpenVINO is not installed")
@pytest.mark.parametrize("name", ["zeta_tail", *TRANSLATORS])
def test_both_runtimes_agree(name: str) -> None:
    """Whoever installs OpenVINO gets the same maps to a part in 1000."""
    with open_network(name, ENGINE) as network:
        maps = like_maps(network.description.channels, 64, 96)
        exact = untiled(network, maps)
    with open_network(name, Engine("openvino", threads=2)) as network:
        assert np.abs(untiled(network, maps) - exact).max() < 2e-3


@pytest.mark.parametrize("name", TRANSLATORS)
@pytest.mark.parametrize("value", [-1.0, 1.0, 0.3])
def test_black_white_and_constant_maps(name: str, value: float) -> None:
    """The logarithm of black, a constant without any detail: finite, in range, normals that face outwards."""
    with open_network(name, ENGINE) as network:
        what = network.description
        side = 8 * what.stride + 2 * what.margin
        result = network.run(np.full((len(what.channels), side, side), value, np.float32))
    assert np.isfinite(result).all()
    if "slope" in what.outputs[0]:
        assert (1 / np.sqrt(np.square(result).sum(0) + 1)).min() > 0.2
    else:
        assert np.abs(result).max() <= 1 + 1e-5


def test_a_constant_map_shows_no_checkerboard() -> None:
    """Pixel shuffles and strides must not print their pattern on even skin: pores would be read off it."""
    for name in ("rho", "sigma"):
        with open_network(name, ENGINE) as network:
            what = network.description
            side = 8 * what.stride + 2 * what.margin
            maps = np.zeros((len(what.channels), side, side), np.float32)
            for i, channel in enumerate(what.channels):
                for k, name in enumerate(channel.split(PACKED)):
                    maps[i, k // 2 :: 2, k % 2 :: 2] = 0.8 if name.endswith("_z") else 0
            inside = network.run(maps)
        assert inside.std((1, 2)).max() < 5e-3, name


HEAD = load_head(None)
SIZE = (288, 192)
SKIN = np.array([0.40, 0.23, 0.16], np.float32)
CHART = Chart.build(HEAD, *SIZE)


def plane(*names: str) -> np.ndarray:
    """(h, w) of regions of the head on the context's chart."""
    return np.asarray(CHART.interpolate(vertex_mask(HEAD, *names)[:, None])[..., 0] * CHART.mask, np.float32)


def clue(subject: Subject, name: str) -> np.ndarray:
    """(h, w) one of the subject's clues."""
    return np.asarray(subject.clues[CLUES.index(name)])


def test_a_beard_is_shown_and_inpainted_skin_and_the_shadow_of_a_cap_are_not() -> None:
    """What completes unseen skin goes by beards too, but not by all that is dark: a cap's shadow would grow on."""
    beard, forehead = (cv2.resize(plane(name), GEOMETRY_SIZE) > 0.9 for name in ("beard", "forehead"))
    inpainted = np.zeros(GEOMETRY_SIZE[::-1], np.float32)
    inpainted[:, : GEOMETRY_SIZE[0] // 2] = 1
    lit = np.asarray((1 - inpainted) * ~beard, np.float32)
    subject = replace(Subject.of(HEAD, HEAD.mean), lit=lit, inpainted=inpainted)
    shown, seen = clue(subject, SHOWN), inpainted == 0
    assert clue(subject, LIT)[beard].max() == 0
    assert shown[beard & seen].min() > 0.5
    assert shown[~seen].max() == 0 and shown[forehead].max() == 0


def test_a_photo_without_lit_skin_counts_whole() -> None:
    """The mean over nothing would be divided by; all skin is as good a guess as any."""
    nothing = np.zeros((64, 96), np.float32)
    subject = Subject.of(HEAD, HEAD.mean)
    assert np.array_equal(clue(replace(subject, lit=nothing), LIT), clue(subject, LIT))
