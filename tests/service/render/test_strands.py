"""Light on strands: transmittance against Beer's law, reflection against the conservation of energy."""

from __future__ import annotations

import numpy as np
import pytest

from service.light.environment import spread_directions
from service.light.scene import PointLight
from service.render.strands import TILT, HairVolume, reflected


def slab(layers: float) -> HairVolume:
    """60 x 60 mm of hair at height 0, as opaque as so many layers."""
    x, y = np.meshgrid(np.arange(-30, 30, 1.0) + 0.5, np.arange(-30, 30, 1.0) + 0.5)
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1).astype(np.float32)
    return HairVolume(points, np.full(len(points), layers, np.float32), len(points))


def test_light_through_a_layer_falls_by_beers_law() -> None:
    below = np.array([[0.0, 0, -20], [5, -7, -20]], np.float32)
    for layers in (0.3, 1.0, 2.5):
        assert slab(layers).passed(below, np.array([0, 0, 1.0]), 0.4) == pytest.approx(np.exp(-layers), rel=0.1)


def test_what_lies_before_hair_or_beside_it_is_lit() -> None:
    volume, up = slab(3.0), np.array([0, 0, 1.0])
    assert volume.passed(np.array([[0, 0, 20.0]], np.float32), up, 0.4) == pytest.approx(1)
    assert volume.passed(np.array([[60, 0, -20.0]], np.float32), up, 0.4) == pytest.approx(1, abs=0.02)
    # What is seen lies on top of the body of hair, and is not shaded by itself.
    assert volume.passed(np.array([[0, 0, 0.0]], np.float32), up, 1.0) == pytest.approx(1, abs=0.02)


def test_a_near_lamp_throws_a_wider_shadow() -> None:
    volume, lamp = slab(3.0), PointLight((0.0, 0.0, 0.1), (1, 1, 1))
    beside = np.array([[40.0, 0, -60]], np.float32)
    assert volume.from_lamp(beside, lamp, 0.4) < 0.2
    assert volume.passed(beside, np.array([0, 0, 1.0]), 0.4) > 0.9


@pytest.mark.parametrize("colour", [0.0, 0.1, 1.0])
def test_strands_reflect_no_more_than_they_receive(colour: float) -> None:
    ways = spread_directions(2000).astype(np.float32)
    along = np.tile(np.array([1, 0, 0], np.float32), (len(ways), 1))
    for degrees in (0, 30, 60):
        light = np.array([np.sin(np.radians(degrees)), 0, np.cos(np.radians(degrees))], np.float32)
        out = reflected(along, ways, light, np.full((len(ways), 3), colour, np.float32))
        assert (out >= 0).all()
        assert out[:, 0].mean() * 4 * np.pi < 1.0


def test_the_first_highlight_lies_towards_the_root() -> None:
    angle = np.radians(np.linspace(-40, 40, 161))
    view = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], 1).astype(np.float32)
    along = np.tile(np.array([1, 0, 0], np.float32), (len(view), 1))
    black = reflected(along, view, np.array([0, 0, 1], np.float32), np.zeros((len(view), 3), np.float32))[:, 0]
    assert angle[black.argmax()] == pytest.approx(-4 * TILT, abs=0.02)


def test_light_along_a_strand_gives_no_nan() -> None:
    x = np.array([[1, 0, 0]], np.float32)
    assert np.isfinite(reflected(x, x, x[0], np.ones((1, 3), np.float32))).all()
