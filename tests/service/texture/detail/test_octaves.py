"""Octaves add up to the image, and each holds its own periods."""

from __future__ import annotations

import numpy as np
import pytest

from service.texture.photo_sampling import joined, split

RANDOM = np.random.default_rng(3)


@pytest.mark.parametrize("shape", [(64, 96), (64, 96, 3)])
def test_octaves_and_the_rest_are_the_image(shape: tuple[int, ...]) -> None:
    image = RANDOM.random(shape, np.float32)
    bands, rest = split(image, 4)
    assert [band.shape[:2] for band in bands] == [(64, 96), (32, 48), (16, 24), (8, 12)]
    assert np.abs(joined(bands, rest) - image).max() < 1e-5


def test_a_constant_has_no_detail() -> None:
    bands, rest = split(np.full((32, 32), 0.7, np.float32), 3)
    assert max(float(np.abs(band).max()) for band in bands) < 1e-6
    assert np.allclose(rest, 0.7)


@pytest.mark.parametrize(("period", "octave"), [(3.0, 0), (5.7, 1), (11.3, 2), (22.6, 3)])
def test_a_wave_lies_in_its_octave(period: float, octave: int) -> None:
    wave = np.tile(np.cos(2 * np.pi * np.arange(256) / period), (256, 1)).astype(np.float32)
    power = [float((band[4:-4, 4:-4] ** 2).sum()) * 4**index for index, band in enumerate(split(wave, 5)[0])]
    assert int(np.argmax(power)) == octave
    assert power[octave] > 0.6 * sum(power)
