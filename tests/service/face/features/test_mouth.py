"""Lips are brought to the rim of the photo's mouth.

The light that teeth show, alone and together with eyes, and what is no tooth.
"""

from __future__ import annotations

import numpy as np
import pytest

from service.colour import linear_to_srgb, to_bytes
from service.face.features.eye_colours import (
    CHEEKS,
    RANGE,
    cheek_colour,
    palest,
)
from service.face.features.eyes import SeenRims
from service.face.features.mouth import TOOTH, UNITS, lips_on_rim, measure_teeth, teeth_light, with_mouth_shut
from service.face.features.rims import RIMS
from service.face.fit.fit import Fit
from service.geometry.camera import Camera
from service.head.model import HeadModel
from service.head.regions import lip_edges
from tests.service.face.geometry import FOCAL, VIEW, units
from tests.toyhead import sphere_head

PLACES = np.linspace(-0.017, 0.017, 9) * FOCAL + 500.0
UPPER, LOWER = slice(1, 10), slice(11, 20)


def opening(head: HeadModel, expression: np.ndarray) -> np.ndarray:
    """(2, 9) pixel rows of the upper and the lower lip's edge at ``PLACES``, seen from the front."""
    edges = lip_edges(head)
    assert edges is not None
    vertices, found = head.shape(np.zeros(0), expression), []
    for lip, bound in ((edges.upper, np.max), (edges.lower, np.min)):
        rows = [VIEW.project(vertices[own]) for own in lip]
        found.append(bound([np.interp(PLACES, *row[np.argsort(row[:, 0])].T) for row in rows], 0))
    return np.stack(found)


def rim(head: HeadModel, expression: np.ndarray, apart_px: float = 0.0) -> np.ndarray:
    """(20, 2) of the landmark network, whose lips are a little apart when they are closed."""
    upper, lower = opening(head, expression)
    points = np.zeros((20, 2))
    points[0], points[10] = (PLACES[0] - 12, (upper[0] + lower[0]) / 2), (PLACES[-1] + 12, (upper[-1] + lower[-1]) / 2)
    points[UPPER] = np.stack([PLACES, upper - apart_px / 2], 1)
    points[LOWER] = np.stack([PLACES, np.maximum(lower, upper) + apart_px / 2], 1)[::-1]
    return np.roll(points, 10, axis=0)


def gap_mm(head: HeadModel, expression: np.ndarray) -> float:
    upper, lower = opening(head, expression)
    return float((lower - upper)[2:-2].mean()) * 1e3 / FOCAL


def lips(
    head: HeadModel, neutral: np.ndarray, start: np.ndarray, view: Camera, points: np.ndarray, teeth_seen: bool,
    exact: bool = False,
) -> np.ndarray:  # fmt: skip
    landmarks = np.zeros((468, 2))
    landmarks[list(RIMS["mouth"])] = points
    seen = SeenRims(start, view, landmarks, frozenset({"mouth"} if exact else ()))
    return lips_on_rim(head, neutral, seen, teeth_seen)


@pytest.mark.parametrize("apart_mm", [2.5, 3.5])
@pytest.mark.parametrize(
    "wrong", [{"mouthUpperUp": 0.25}, {"mouthLowerDown": 0.3}, {"mouthUpperUp": 0.3, "mouthSmile": 0.3}]
)
def test_a_closed_mouth_is_closed(head: HeadModel, wrong: dict[str, float], apart_mm: float) -> None:
    """A millimetre of teeth shows between lips that the photo shows closed, however far apart the network has them."""
    before = units(head, **wrong)
    assert gap_mm(head, before) > 0.5
    after = lips(head, head.mean, before, VIEW, rim(head, np.zeros(len(before)), apart_mm), teeth_seen=False)
    assert gap_mm(head, after) < 0.35
    others = [k for k, name in enumerate(head.expression_names) if name not in UNITS]
    assert np.array_equal(after[others], before[others])
    assert (after >= 0).all() and (after <= 1).all()


def test_what_cannot_be_read_changes_nothing(head: HeadModel) -> None:
    """A mouth without a width, landmarks that are not numbers, a head without lips or seen from behind."""
    before = units(head, mouthUpperUp=0.3)
    good = rim(head, before)
    behind = Camera(1000, 1000, FOCAL, VIEW.principal_point, np.diag([1.0, 1.0, 1.0]), VIEW.translation)
    for points, view in ((np.full((20, 2), 500.0), VIEW), (np.full((20, 2), np.nan), VIEW), (good, behind)):
        assert np.array_equal(lips(head, head.mean, before, view, points, teeth_seen=False), before)
    toy = sphere_head(24, 48)
    none = np.zeros(len(toy.expression))
    assert np.array_equal(lips(toy, toy.mean, none, VIEW, good, teeth_seen=True), none)
    assert lip_edges(toy) is None
    wild = lips(head, head.mean, before, VIEW, good * [[1.0, 1e6]], teeth_seen=True)
    assert np.isfinite(wild).all() and (wild >= 0).all() and (wild <= 1).all()


def test_a_mouth_that_is_said_to_be_shut_is(head: HeadModel) -> None:
    """No gap is left between the lips, and what else the face does stays."""
    wide = units(head, mouthUpperUp=0.3, mouthSmile=0.3)
    wide[head.expression_names.index("jawOpen")] = 0.4
    fit = Fit(VIEW, np.zeros(0), wide, head.shape(np.zeros(0), wide), head.mean, None, 1.0, 60.0)
    shut = with_mouth_shut(head, fit)
    assert gap_mm(head, wide) > 1.0 and gap_mm(head, shut.expression) < 0.35
    np.testing.assert_allclose(shut.vertices, head.expressed(head.mean, shut.expression))
    kept = [k for k, name in enumerate(head.expression_names) if "Smile" in name]
    assert np.array_equal(shut.expression[kept], wide[kept])


RIM = np.array([[20, 30], [40, 20], [60, 18], [80, 20], [100, 30], [80, 42], [60, 45], [40, 42]], float)
SKINS = {"dark": [0.12, 0.055, 0.035], "brown": [0.30, 0.17, 0.11], "light": [0.55, 0.36, 0.27]}
def mouth(inside: np.ndarray, light: np.ndarray, skin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lips in a light with something between them, and the colour of the skin in that light."""

    def shown(albedo: np.ndarray) -> np.ndarray:
        return to_bytes(linear_to_srgb(albedo * light))

    image = np.empty((64, 128, 3), np.uint8)
    image[:] = shown(skin * [1.0, 0.55, 0.6])
    image[22:38, 30:90] = shown(inside)
    return image, shown(skin) / 255


def light_between(pixels: np.ndarray, rim: np.ndarray, skin: np.ndarray) -> np.ndarray | None:
    """As the fit goes about it."""
    tooth = measure_teeth(pixels, rim, skin)
    return None if tooth is None else teeth_light(tooth, skin)


@pytest.mark.parametrize("rim", [RIM + 500, np.full_like(RIM, np.nan), np.repeat(RIM[:1], 8, 0)])
def test_no_mouth_no_light(rim: np.ndarray) -> None:
    """A mouth beyond the border, lost, or shut."""
    pixels, usual = mouth(TOOTH, np.ones(3) * 0.5, np.array(SKINS["light"]))
    assert light_between(pixels, rim, usual) is None


def test_black_and_overexposed_photos_tell_nothing() -> None:
    """Ratios of nothing, and white that is only the end of the scale."""
    for value in (0, 255):
        pixels = np.full((64, 128, 3), value, np.uint8)
        for skin in (np.zeros(3), np.ones(3), np.array([0.7, 0.5, 0.4])):
            assert light_between(pixels, RIM, skin) is None


LIGHT = np.array([0.5, 0.4, 0.3])


def landmarks_at(points: list[tuple[float, float]]) -> np.ndarray:
    found = np.full((468, 2), np.nan)
    found[list(CHEEKS)] = points
    return found


def test_what_is_redder_than_the_palest_does_not_count() -> None:
    """Lids in place of the white would else make half of the light."""
    assert np.allclose(palest(np.array([LIGHT, LIGHT * [1.0, 0.5, 0.4]])), LIGHT)
    assert np.allclose(palest(np.array([LIGHT, 4 * LIGHT])), 2 * LIGHT)
    assert np.allclose(palest(np.array([[90.0, 90.0, 90.0]])), RANGE[1])


@pytest.mark.parametrize("radius", [0.0, 5.0, 400.0, np.nan])
def test_cheeks_at_the_border_and_beyond(radius: float) -> None:
    """A patch reaches out of the photo, is empty, or has no size."""
    pixels = np.full((40, 60, 3), 51, np.uint8)
    at = landmarks_at([(0.0, 39.9), (-50.0, 10.0)])
    found = cheek_colour(pixels, at, radius / 0.12)
    assert found is None or np.allclose(found, 0.2)
    assert cheek_colour(pixels, landmarks_at([(-50.0, -50.0), (999.0, 10.0)]), 10.0) is None
