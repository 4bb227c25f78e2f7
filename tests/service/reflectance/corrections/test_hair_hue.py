"""Hair has a hue that hair has, and what is no hair keeps its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.colour import luma
from service.head.files import load_head
from service.reflectance.corrections.hair_hue import BLACK, DARK, REDDEST
from service.reflectance.corrections.hair_hue import like_hair as on_planes
from service.reflectance.subject import CLUES, HAIR, Subject

HEAD = load_head(None)
NOWHERE = np.zeros((1, 1), np.float32)
HERE = np.ones((1, 1), np.float32)


def like_hair(albedo: np.ndarray, brow: np.ndarray, hair: np.ndarray) -> np.ndarray:
    """On sRGB in [0, 1]."""
    return on_planes(albedo * 2 - 1, brow, hair) * np.float32(0.5) + np.float32(0.5)


def one(*code: int) -> np.ndarray:
    return np.array(code, np.float32).reshape(1, 1, 3) / np.float32(255)


@pytest.mark.parametrize("code", [(23, 4, 12), (35, 22, 50), (10, 10, 30), (4, 30, 4), (0, 0, 25)])
def test_black_hair_is_neither_blue_nor_purple_nor_red(code: tuple[int, int, int]) -> None:
    """A warm lamp divided out of black leaves blue; the shades of a film leave purple."""
    for found in (like_hair(one(*code), NOWHERE, HERE), like_hair(one(*code), HERE, NOWHERE)):
        red, green, blue = found[0, 0]
        assert red >= green - 1e-6 and green >= blue - 1e-6
        assert red <= (REDDEST + 3 * max(float(luma(one(*code))[0, 0]) - 0.1, 0)) * luma(found)[0, 0] + 1e-5
        if code != (0, 0, 25):
            np.testing.assert_allclose(luma(found), luma(one(*code)), atol=2e-3)


@pytest.mark.parametrize("code", [(60, 40, 30), (30, 25, 20), (128, 90, 60), (150, 150, 150), (0, 0, 0)])
def test_hair_of_a_usual_hue_keeps_it(code: tuple[int, int, int]) -> None:
    for brow, hair in ((HERE, NOWHERE), (NOWHERE, HERE), (HERE, HERE)):
        np.testing.assert_allclose(like_hair(one(*code), brow, hair), one(*code), atol=1e-3)


def test_skin_and_bright_cloth_keep_their_colour() -> None:
    """A scarf may be blue; so may what no mask calls hair."""
    for code in ((23, 4, 12), (180, 120, 100)):
        np.testing.assert_allclose(like_hair(one(*code), NOWHERE, NOWHERE), one(*code), atol=1e-6)
    scarf = one(40, 70, 140)
    assert luma(scarf)[0, 0] > DARK > BLACK
    np.testing.assert_allclose(like_hair(scarf, NOWHERE, HERE), scarf, atol=1e-6)


def test_hair_is_the_scalp_and_what_covers_skin_but_no_lips_and_no_cap() -> None:
    lit = np.ones((64, 96), np.float32)
    lit[:, :48] = 0
    worn = np.zeros((64, 96), np.float32)
    worn[:16] = 1
    subject = replace(Subject.of(HEAD, HEAD.mean), lit=lit, worn=worn)
    hair = subject.clues[CLUES.index(HAIR)]
    names = ("scalp", "lips", "cheek_left", "cheek_right")
    region = {name: subject.chart.interpolate(HEAD.region(name)[:, None])[..., 0] for name in names}
    columns = np.arange(hair.shape[1])[None] < hair.shape[1] / 2 - 8
    rows = np.arange(hair.shape[0])[:, None] > 150
    assert hair[(region["scalp"] > 0.99) & rows & (subject.own_skin > 0)].min() > 0.9
    assert hair[(region["lips"] > 0.9)].max() < 0.02
    assert hair[:100].max() < 0.02, "a cap"
    cheek = region["cheek_left"] + region["cheek_right"] > 0.9
    assert hair[cheek & columns].min() > 0.95 and hair[cheek & ~columns & (np.arange(768)[None] > 400)].max() < 0.05
