"""What the networks of normals read: shaded grey, drawn detail, and grey beyond what is seen."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from service.arrays import Float32
from service.colour import FULL_CODE, LUMA, linear_to_srgb
from service.manifest import Octave
from service.reflectance.planes import Planes
from service.reflectance.relief.normal_inputs import drawn_detail, shaded_grey, without_border
from service.reflectance.subject import GEOMETRY_SIZE
from service.runtime.network_registry import CONTEXT as LIGHT
from service.runtime.network_registry import LIT

Float = npt.NDArray[np.float32]

SIZE = (96, 600)
ALBEDO = np.array([0.5, 0.3, 0.22], np.float32)


def codes_of(linear: Float) -> npt.NDArray[np.uint16]:
    return np.rint(linear_to_srgb(linear) * FULL_CODE).astype(np.uint16)


def planes_of(texture: npt.NDArray[np.uint16], log_light: Float) -> Planes:
    planes = Planes(SIZE)
    planes.add_codes("texture", texture)
    planes.add_coarse(LIGHT, np.stack([log_light] * 3))
    return planes


def in_light(shade: Float) -> tuple[npt.NDArray[np.uint16], Float]:
    """Texture in light from the side with a finer shade, and the light's logarithm."""
    light = np.broadcast_to(np.linspace(-1.8, 0.2, SIZE[0], dtype=np.float32), SIZE[::-1])
    albedo = np.broadcast_to(ALBEDO, (*SIZE[::-1], 3))
    return codes_of(albedo * np.exp(light + shade)[..., None]), np.ascontiguousarray(light)


def test_a_crease_is_seen_and_the_light_that_it_lies_in_is_not() -> None:
    """delta takes the crease off the albedo: read there, wrinkles would come out flat."""
    crease = np.zeros(SIZE[::-1], np.float32)
    crease[300] = -0.5
    grey = shaded_grey(planes_of(*in_light(crease))) / FULL_CODE
    expected = float(linear_to_srgb(ALBEDO) @ LUMA)
    plain = np.delete(grey, 300, axis=0)
    assert np.abs(plain / expected - 1).max() < 0.06, "the light goes; sRGB is not quite a power"
    assert np.abs(grey[300] / plain[299] / np.exp(-0.5 / 2.2) - 1).max() < 0.04


@pytest.mark.parametrize("strength", [-1e4, 1e4, np.nan, np.inf])
def test_any_light_gives_a_value(strength: float) -> None:
    """exp of it would overflow, and a NaN in 16-bit codes is any number."""
    texture, light = in_light(np.zeros(SIZE[::-1], np.float32))
    usual = shaded_grey(planes_of(texture, light))
    light[:, :40] = strength
    with np.errstate(all="raise", under="ignore"):
        grey = shaded_grey(planes_of(texture, light))
    assert grey.shape == SIZE[::-1]
    assert np.ptp(grey[:, :30], axis=0).max() == 0, "the same in every row"
    assert np.array_equal(grey[:, 50:], usual[:, 50:])


HALF = np.repeat(np.array([[1, 0]], np.float32), 288, 1)[[0] * 384]
"""A photo that shows the left half of a texture of 576 x 384."""


def octaves(*shares: float) -> list[Octave]:
    return [Octave(0.13 * 2**k, 0.27 * 2**k, share) for k, share in enumerate(shares)]


def test_a_sharp_photo_draws_its_own_skin_and_no_more() -> None:
    """Else rho would read relief off the pigment of the one, and leave the other without pores."""
    drawn = drawn_detail(HALF, octaves(1, 1, 1, 1, 1), 1.0)
    width = GEOMETRY_SIZE[0]
    assert (drawn[:, : width // 2 - 2] == -1).all() and (drawn[:, width // 2 + 2 :] == 1).all()


def test_shares_out_of_range_stay_in_it() -> None:
    """NaN in the photo's opacity or a share beyond 1 would reach a network that was taught [-1, 1]."""
    broken = np.full_like(HALF, np.nan)
    for seen, told in ((HALF * 3, octaves(2.0, 2.0)), (broken, octaves(1.0, 1.0))):
        drawn = drawn_detail(seen, told, 1.0)
        assert np.isfinite(drawn).all() and np.abs(drawn).max() <= 1


BORDER_SIZE = (1536, 1024)
Y, X = np.mgrid[: GEOMETRY_SIZE[1], : GEOMETRY_SIZE[0]]
FROM_MIDDLE = np.hypot(X - 384, Y - 256)
FACE, EYE = 150, 20
LIT_SKIN = ((FROM_MIDDLE < FACE) & (FROM_MIDDLE > EYE)).astype(np.float32)
GRAIN = np.random.default_rng(5).normal(0, 400, BORDER_SIZE[::-1])


def planes(lit: Float32) -> Planes:
    made = Planes(BORDER_SIZE)
    made.add_coarse((LIT,), lit[None])
    return made


def rimmed() -> np.ndarray:
    """Skin with a dark line of 4 mm where the face ends, another tone beyond it, a dark eye, and grain all over."""
    tone = np.where(FROM_MIDDLE < FACE, 30000.0, 22000.0)
    tone -= 12000 * np.exp(-(((FROM_MIDDLE - FACE + 1) / 2) ** 2))
    tone -= 9000 * (FROM_MIDDLE < EYE)
    return np.rint(cv2.resize(tone.astype(np.float32), BORDER_SIZE) + GRAIN).astype(np.uint16)


def at(low: float, high: float) -> np.ndarray:
    far = cv2.resize(FROM_MIDDLE.astype(np.float32), BORDER_SIZE)
    return np.asarray((far > low) & (far < high))


def test_the_dark_line_and_the_step_go_and_the_grain_stays() -> None:
    before, after = rimmed(), without_border(rimmed(), planes(LIT_SKIN))
    coarse = cv2.GaussianBlur(after.astype(np.float32), (0, 0), 4)
    assert np.ptp(coarse[at(FACE - 30, FACE + 60)]) < 0.1 * 12000
    far = at(FACE + 20, FACE + 60)
    whole = [image.astype(np.float32) for image in (before, after)]
    fine = [image - cv2.GaussianBlur(image, (0, 0), 2) for image in whole]
    assert fine[1][far].std() == pytest.approx(fine[0][far].std(), rel=0.05)


def test_what_is_seen_stays_to_the_bit_openings_too() -> None:
    before, after = rimmed(), without_border(rimmed(), planes(LIT_SKIN))
    inside = at(-1, FACE - 20)
    assert (before[inside] == after[inside]).all()


@pytest.mark.parametrize("lit", [0.0, 1.0])
def test_nothing_changes_where_none_or_all_of_it_is_seen(lit: float) -> None:
    assert (without_border(rimmed(), planes(np.full_like(LIT_SKIN, lit))) == rimmed()).all()
    assert (without_border(rimmed(), Planes(BORDER_SIZE)) == rimmed()).all()
