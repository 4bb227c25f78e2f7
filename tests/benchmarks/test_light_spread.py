"""The measures of the benchmark of lights: each on a case whose answer is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch")

from benchmarks.heads import TexturedHead
from benchmarks.light_spread import ALL, Run, Spread, psnr, table, true_albedo
from service.colour import linear_to_srgb, srgb_to_linear

RNG = np.random.default_rng(0)
SHAPE = (16, 24)


def run(albedo: float, texture: float, seen: bool = True) -> Run:
    maps = {"albedo": np.full((*SHAPE, 3), albedo), "texture": np.full((*SHAPE, 3), texture)}
    return Run((20.0, 21.0), (17.0, 18.0), (10.0, 11.0), maps, np.full(SHAPE, seen))


def test_a_gain_of_linear_values_is_forgiven_once_and_not_in_the_raw_number() -> None:
    truth = RNG.uniform(0.2, 0.7, (500, 3))
    darker = linear_to_srgb((0.6 * srgb_to_linear(truth.astype(np.float32))).astype(np.float32)).astype(np.float64)
    raw, best = psnr(darker, truth)
    assert raw < 25
    assert best > 60
    assert psnr(truth, truth) == (100.0, 100.0)


def test_nothing_to_compare_is_an_error() -> None:
    with pytest.raises(ValueError, match="no pixel"):
        psnr(np.zeros((0, 3)), np.zeros((0, 3)))


def test_spread_over_lights_and_over_heads() -> None:
    """Albedo differs between heads alone, the texture between lights alone; hidden texels do not count."""
    runs = {
        (who, light): run(tone, bright)
        for who, tone in (("a", 0.3), ("b", 0.5))
        for light, bright in (("soft", 0.4), ("left", 0.6))
    }
    kinds = {"a": "one", "b": "other"}
    found = Spread.of(runs, kinds, "albedo")
    assert found.over_lights == pytest.approx({"one": 0, "other": 0, ALL: 0})
    assert found.over_heads == pytest.approx(np.sqrt(0.02))
    found = Spread.of(runs, kinds, "texture")
    assert found.over_lights == pytest.approx(dict.fromkeys(("one", "other", ALL), np.sqrt(0.02)))
    assert found.over_heads == pytest.approx(0)
    odd = runs["a", "soft"]
    odd.maps["albedo"][:4] = 1.0
    odd.seen[:4] = False
    assert Spread.of(runs, kinds, "albedo").over_lights[ALL] == pytest.approx(0.0)
    odd.maps["albedo"][4:] = 0.5
    uneven = Spread.of(runs, kinds, "albedo").over_lights
    assert uneven == pytest.approx({"one": np.sqrt(0.02), "other": 0, ALL: 0.1}), "heads count alike"
    lines = table(runs, kinds, "draft")
    assert "| all | all | mean | **20.0** | **21.0** | **18.0** | **10.0** | **11.0** |" in lines
    runs["a", "soft"] = replace(runs["a", "soft"], albedo=(22.0, 25.0))
    lines = table(runs, kinds, "draft")
    assert "| one | a | mean | **21.0** | **23.0** | **18.0** | **10.0** | **11.0** |" in lines, "over its lights"
    assert "| other | b | mean | **20.0** | **21.0** | **18.0** | **10.0** | **11.0** |" in lines
    assert f"{12 * 24} texels" in lines[-1]


def test_the_true_albedo_is_that_of_the_nearest_skin_and_eyes_are_left_out() -> None:
    vertices = RNG.uniform(-0.1, 0.1, (4000, 3)) * [1, 1, 0]
    colours = np.where(vertices[:, :1] > 0, [[0.5, 0.3, 0.2]], [[0.2, 0.1, 0.1]])
    eyes = np.array([[0.05, 0.05, 0.0], [-0.05, 0.05, 0.0]])
    head = TexturedHead("plane", vertices, np.zeros((0, 3), np.int64), colours, eyes, 0.012)
    position = np.array([[[0.06, -0.05, 0.0], [-0.06, -0.05, 0.0], [0.05, 0.05, 0.001], [0.5, 0.0, 0.0], [0, 0, 0]]])
    mask = np.array([[True, True, True, True, False]])
    albedo, skin = true_albedo(head, position, mask)
    np.testing.assert_allclose(albedo[0, :2], [[0.5, 0.3, 0.2], [0.2, 0.1, 0.1]])
    assert skin.tolist() == [[True, True, False, False, False]]
