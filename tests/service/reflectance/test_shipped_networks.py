"""The networks in the box."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from service.bench.runs import degrees
from service.colour import FULL_CODE, linear_to_srgb
from service.geometry.chart import Chart
from service.head.files import load_head
from service.head.regions import vertex_mask
from service.reflectance.albedo.diffuse_albedo import LIGHT_NETWORK, found_by
from service.reflectance.planes import Planes
from service.reflectance.subject import GEOMETRY_SIZE, Subject
from service.runtime.network_registry import CLUES, GEOMETRY, LIT, SHOWN
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
    """A halo shorter than what the trained weights use, or a norm over the tile, would show as seams."""
    with open_network(name, ENGINE) as network:
        maps = like_maps(network.description.channels, 320, 440)
        whole = untiled(network, maps)
        assert np.abs(tiled(network, maps, 128) - whole).max() <= SEAM
        assert np.abs(tiled(network, maps, 256) - whole).max() <= SEAM


def degrees_apart(one: Float, other: Float) -> Float:
    """Angles between the vectors of two maps (3, h, w)."""
    return np.asarray(degrees(np.moveaxis(one, 0, 2), np.moveaxis(other, 0, 2)), np.float32)


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


@pytest.mark.parametrize("name", ["rho", "sigma"])
def test_drawn_pores_are_deep_and_a_photos_spots_are_not(name: str) -> None:
    """Else pores of soft photos are mere colour, which no light brings out, or freckles of sharp ones are dents."""
    with open_network(name, ENGINE) as network:
        what = network.description
        side = 16 * what.stride
        y, x = np.indices((side, side)) % 16 - 8
        spots = np.asarray(0.3 - 0.12 * np.exp(-(x * x + y * y) / (2 * 1.6**2)), np.float32)
        slope = []
        for drawn in (-1.0, 1.0):
            values = {"normal_tangent_z": 1.0, "normal_object_z": 1.0, "drawn_detail": drawn}
            planes = [np.full_like(spots, values.get(name, 0.0)) for name in what.channels]
            planes[what.channels.index("shaded_grey")] = spots
            normal = network.run(np.stack(planes))
            slope.append(float(np.hypot(*normal[:2]).mean()))
    assert slope[1] > 2 * slope[0]


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
    """The logarithm of black, a constant without any detail: finite, in range, normals of unit length."""
    with open_network(name, ENGINE) as network:
        what = network.description
        side = 8 * what.stride
        result = network.run(np.full((len(what.channels), side, side), value, np.float32))
    assert np.isfinite(result).all() and np.abs(result).max() <= 1 + 1e-5
    if len(what.outputs) == 3 and "normal" in what.outputs[0]:
        assert np.abs(np.square(result).sum(0) - 1).max() < 1e-4
        assert result[2].min() > 0.2


def test_a_constant_map_shows_no_checkerboard() -> None:
    """Pixel shuffles and strides must not print their pattern on even skin: pores would be read off it."""
    for name in ("rho", "sigma"):
        with open_network(name, ENGINE) as network:
            what = network.description
            side = 8 * what.stride + 2 * what.halo
            maps = np.zeros((len(what.channels), side, side), np.float32)
            maps[[i for i, channel in enumerate(what.channels) if channel.endswith("_z")]] = 0.8
            inside = network.run(maps)[:2, what.halo : -what.halo, what.halo : -what.halo]
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


def test_hair_of_any_colour_leaves_the_light_of_the_face() -> None:
    """The network in the box, and a face from the side in black, blond and no hair.

    Heads of the light stage are bald. A network that looks at hair takes black hair for deep shade and the face below
    it for brightly lit: on albedo maps of real people that have a cap of black, that cost 5 dB.
    """
    hair = plane("scalp") > 0.4
    subject = replace(Subject.of(HEAD, HEAD.mean), lit=np.where(hair, 0, 1).astype(np.float32))
    sideways = subject.geometry[GEOMETRY.index("normal_object_x")]
    lit_face = SKIN * np.exp(0.6 * cv2.resize(sideways, SIZE, interpolation=cv2.INTER_AREA))[..., None]
    face = plane("face") > 0.9
    lights = []
    with open_network(LIGHT_NETWORK, Engine(threads=2)) as network:
        assert LIT in network.description.channels
        for colour in ((0.008, 0.007, 0.006), (0.45, 0.33, 0.18), SKIN):
            linear = np.where(hair[..., None], np.asarray(colour, np.float32), lit_face).astype(np.float32)
            planes = Planes(SIZE)
            planes.add_codes("texture", np.rint(linear_to_srgb(linear) * FULL_CODE).astype(np.uint16))
            planes.add_coarse(GEOMETRY, subject.geometry)
            planes.add_coarse(CLUES, subject.clues)
            lights.append(found_by(network, planes).light)
    for other in lights[1:]:
        # Texels of the hairline are shared by both.
        assert np.abs((other - lights[0])[:, face & ~hair]).mean() < 0.01
    sides = lights[0].mean(0)[face]
    right = (np.arange(SIZE[0]) > SIZE[0] / 2) * np.ones((SIZE[1], 1), bool)
    found = sides[right[face]].mean() - sides[~right[face]].mean()
    told = np.log(lit_face.mean(2))[face]
    assert found == pytest.approx(told[right[face]].mean() - told[~right[face]].mean(), rel=0.6), "it sees the face"


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
