"""The camera of the rendered photos: each of its ways does what its name says."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from benchmarks.corrections.camera import FACE_LEVEL, Camera, develop, encoded
from service.colour import LUMA, srgb_to_linear

STEPS = np.linspace(0.02, 3.0, 64, dtype=np.float32)
RAMP = np.tile(STEPS[None, :, None], (64, 1, 3)) * np.array([1.0, 0.8, 0.6], np.float32)
FACE = np.ones(RAMP.shape[:2], bool)


def linear(pixels: np.ndarray) -> np.ndarray:
    return srgb_to_linear(pixels.astype(np.float32) / 255)


def test_exposure_is_the_faces_whatever_the_lamp_and_stops_are_powers_of_two() -> None:
    usual, brighter = develop(RAMP, FACE, Camera()), develop(RAMP * 7, FACE, Camera())
    np.testing.assert_array_equal(usual, brighter)
    level = np.quantile(linear(usual) @ LUMA, 0.9)
    assert level == pytest.approx(FACE_LEVEL, rel=0.02)
    dim = develop(RAMP, FACE, Camera(stops=-2))
    middle = linear(usual)[0, 30], linear(dim)[0, 30]
    np.testing.assert_allclose(middle[0] / middle[1], 4, rtol=0.05)


def test_a_bend_changes_the_hue_of_shades_and_not_of_white() -> None:
    bent = develop(np.full((8, 8, 3), 1.0, np.float32) * RAMP[:8, :8] ** 0, FACE[:8, :8], Camera(stops=3))
    assert (bent == 255).all()
    grey = np.tile(np.linspace(0.01, 1, 64, dtype=np.float32)[None, :, None], (4, 1, 3))
    film = develop(grey, np.ones((4, 64), bool), Camera(bend=(0.8, 1.0, 1.25))).astype(int)
    assert (film[0, 5:40, 0] > film[0, 5:40, 1]).all()
    assert (film[0, 5:40, 1] > film[0, 5:40, 2]).all()


def test_warm_light_cuts_blue_off_and_a_ceiling_blows_one_channel() -> None:
    warm = develop(RAMP, FACE, Camera(balance=(1.25, 0.8, 0.1)))
    assert (warm[0, :, 2] <= 14).sum() > 5
    blown, plain = develop(RAMP, FACE, Camera(ceiling=(0.6, 1, 1))), develop(RAMP, FACE, Camera())
    assert (blown[..., 0] == 255).sum() > (plain[..., 0] == 255).sum()
    np.testing.assert_array_equal(blown[..., 1:], plain[..., 1:])


@pytest.mark.parametrize(
    ("camera", "start"), [(Camera(size=32, noise=3.0, jpeg=40), b"\xff\xd8"), (Camera(), b"\x89P")]
)
def test_files_are_what_the_camera_writes(camera: Camera, start: bytes) -> None:
    pixels = develop(RAMP, FACE, camera)
    data = encoded(pixels, camera)
    assert data.startswith(start)
    read = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert read is not None and read.shape == ((32, 32, 3) if camera.size else (64, 64, 3))
    np.testing.assert_array_equal(pixels, develop(RAMP, FACE, camera), err_msg="the same photo each time")
