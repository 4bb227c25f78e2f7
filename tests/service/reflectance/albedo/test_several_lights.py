"""The albedo that photos in several lights agree on, against known light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.reflectance.albedo.corrections import ChartLight
from service.reflectance.albedo.diffuse_albedo import agreed_light, photo_planes
from service.reflectance.planes import Planes
from service.runtime.network_registry import EYES
from service.texture.texture import PhotoTexture

SHAPE = (48, 64)
Y, X = np.meshgrid(np.linspace(-1, 1, SHAPE[0]), np.linspace(-1, 1, SHAPE[1]), indexing="ij")
ALBEDO = np.log(np.array([0.45, 0.3, 0.22]))[:, None, None] + 0.05 * np.sin(9 * X + 5 * Y)
FULL = np.ones(SHAPE, np.float32)


def photo(seen: np.ndarray) -> PhotoTexture:
    bytes_ = np.rint(255 * seen).astype(np.uint8)
    blank = np.zeros((*SHAPE, 3))
    return PhotoTexture(blank.astype(np.uint8), bytes_, bytes_, bytes_, blank.astype(np.float32))


def lit(light: np.ndarray, told: np.ndarray) -> ChartLight:
    """A texture in a light (3, h, w), logarithm, of which a network says another."""
    texture = np.exp(ALBEDO + light).astype(np.float32)
    return ChartLight(told.astype(np.float32), told.astype(np.float32), texture, FULL, FULL, 0 * FULL, FULL)


def albedo_of(chart: ChartLight) -> np.ndarray:
    return np.asarray(np.log(chart.texture) - chart.light)


def off(chart: ChartLight) -> float:
    return float(np.sqrt(np.mean((albedo_of(chart) - ALBEDO) ** 2)))


def made(count: int, seen: list[np.ndarray] | None = None) -> tuple[list[PhotoTexture], list[ChartLight]]:
    """Photos in lights from several sides; of each light half is taken for skin."""
    lights = [np.stack([0.6 * (np.cos(k) * X + np.sin(k) * Y)] * 3) - 0.3 * k for k in range(count)]
    charts = [lit(light, 0.5 * (light + 0.3 * k) - 0.3 * k) for k, light in enumerate(lights)]
    return [photo(one) for one in seen or [FULL] * count], charts


def test_lights_from_many_sides_leave_less_in_the_albedo_than_each_alone() -> None:
    photos, charts = made(6)
    answers = iter([(chart, 0.1 * FULL) for chart in charts])
    found = agreed_light(charts[0], photos, lambda one: next(answers))
    assert off(found) < 0.4 * np.mean([off(chart) for chart in charts])


def test_sides_that_one_photo_alone_sees_join_without_a_step() -> None:
    """One of them says that all skin is twice as pale: both are brought to one brightness where both see it."""
    left, right = (X < 0.3).astype(np.float32), (X > -0.3).astype(np.float32)
    light = np.zeros((3, *SHAPE))
    charts = [lit(light, light), lit(light, light - 0.7)]
    answers = iter([(chart, 0.1 * FULL) for chart in charts])
    found = albedo_of(agreed_light(charts[0], [photo(left), photo(right)], lambda one: next(answers))) - ALBEDO
    assert abs(found[..., :8].mean() - found[..., -8:].mean()) < 0.03


def test_each_photo_is_judged_by_the_white_of_its_own_eyes() -> None:
    """That of another photo comes by the skin beside it, whose light from another side differs: 0.6 apart."""
    planes = Planes(SHAPE[::-1])
    planes.add_coarse(EYES, np.stack([0 * FULL, 0 * FULL, 0 * FULL, FULL]))
    grey = replace(photo(FULL), texture=np.full((*SHAPE, 3), 188, np.uint8))
    own, lent = (photo_planes(planes, replace(grey, white=white)) for white in (np.full(3, 0.5), None))
    apart = (own.shrunk(EYES, SHAPE[::-1]) - lent.shrunk(EYES, SHAPE[::-1])).mean((1, 2))
    np.testing.assert_allclose(apart, [*3 * [np.log(0.5)], 0], atol=1e-4)


@pytest.mark.parametrize("seen", [0 * FULL])
def test_photos_that_show_no_skin_change_nothing(seen: np.ndarray) -> None:
    """The weights sum to zero there."""
    photos, charts = made(2, [seen, seen])
    answers = iter([(chart, 0.1 * FULL) for chart in charts])
    assert agreed_light(charts[0], photos, lambda one: next(answers)) is charts[0]
