"""The numbers of the albedo's benchmark against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("skimage")

from benchmarks.albedo import (
    FEWEST,
    brightness,
    regions_of,
    tone_of,
    typology_angle,
)
from service.colour import linear_to_srgb

pytestmark = pytest.mark.train


def test_brightness_is_that_over_the_cheeks() -> None:
    linear = np.full((300, 3), 0.4)
    linear[100:200] = 0.1
    albedo = linear_to_srgb(linear.astype(np.float32)).astype(np.float64)
    ones = np.zeros((3, 300))
    for k in range(3):
        ones[k, 100 * k : 100 * (k + 1)] = 1
    weights = {"cheeks": ones[0], "brows": ones[1], "chin": ones[2], "lids": np.zeros(300)}
    found = brightness(albedo, weights)
    assert found == {"brows": pytest.approx(0.25, abs=1e-3), "chin": pytest.approx(1.0, abs=1e-3)}
    assert brightness(albedo * 0, weights) == {"brows": 0.0, "chin": 0.0}
    few = {"cheeks": ones[0], "brows": (np.arange(300) < FEWEST - 1).astype(float)}
    assert "brows" not in brightness(albedo, few)


def test_the_typology_angle_is_that_of_its_definition() -> None:
    from skimage.color import lab2rgb

    for lightness, yellow, name in ((70.0, 15.0, "light"), (58.0, 18.0, "tan"), (30.0, 15.0, "dark")):
        colour = lab2rgb(np.array([[[lightness, 12.0, yellow]]]))[0, 0]
        angle = typology_angle(colour)
        assert angle == pytest.approx(np.degrees(np.arctan((lightness - 50) / yellow)), abs=0.5)
        assert tone_of(angle) == name
    assert tone_of(90.0) == "light" and np.isfinite(typology_angle(np.zeros(3)))


def test_regions_are_apart_and_none_is_empty() -> None:
    planes = {name: plane > 0.5 for name, plane in regions_of().items()}
    assert all(plane.sum() >= 10 for plane in planes.values())
    names = list(planes)
    for i, one in enumerate(names):
        for other in names[i + 1 :]:
            shared = (planes[one] & planes[other]).sum()
            assert shared < 0.2 * min(planes[one].sum(), planes[other].sum()), (one, other)
