"""Folds of an expression: strain, where they are, and maps without them."""

from __future__ import annotations

import functools
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from service.face.fit.fit import Fit
from service.geometry.chart import Chart
from service.head.files import load_head
from service.reflectance.reflectance_maps import NORMAL_ONE
from service.reflectance.relief.folds import (
    AGES,
    WIDTH,
    Creases,
    Strain,
    aged,
    folds_in,
    unfolded,
    unfolded_albedo,
    wrinkles_of,
)
from service.reflectance.subject import GEOMETRY_SIZE

SIZE = (WIDTH, WIDTH * 2 // 3)
SMILE = {"mouthSmileLeft": 0.9, "mouthSmileRight": 0.9, "cheekSquintLeft": 0.6, "cheekSquintRight": 0.6}

Float = npt.NDArray[np.float64]


@functools.cache
def chart() -> Chart:
    return Chart.build(load_head(None), *GEOMETRY_SIZE)


def fit(units: dict[str, float]) -> Fit:
    """What of a fit tells an expression."""
    head = chart().head
    expression = np.array([units.get(name, 0.0) for name in head.expression_names])
    neutral, posed = head.shape(np.zeros(0)), head.shape(np.zeros(0), expression)
    return cast(Fit, SimpleNamespace(expression=expression, neutral=neutral, vertices=posed))


@functools.cache
def creases() -> Creases:
    found = Creases.of(chart(), fit(SMILE))
    assert found is not None
    return found


def place() -> tuple[int, int, Float]:
    """Row and column of a map of SIZE where the smile compresses in one direction, and that, x right and y down."""
    weights = creases().weights
    only = (weights[0] > 0.9) & (weights[2] < 0.05)  # along u, and not across it: the cheeks, beside the mouth
    sure = np.asarray(cv2.erode(only.astype(np.uint8), np.ones((9, 9), np.uint8)))
    assert sure.any(), "a broad smile compresses the cheeks"
    rows, columns = np.nonzero(sure)
    middle = len(rows) // 2
    return 2 * int(rows[middle]) + 1, 2 * int(columns[middle]) + 1, np.array([1.0, 0.0])


def groove(row: int, column: int, across: Float, depth: float = 0.4) -> npt.NDArray[np.int16]:
    """Normals of a flat map with one groove, 1 mm wide and 12 mm long, as slopes ``depth`` steep."""
    v, u = np.mgrid[0 : SIZE[1], 0 : SIZE[0]].astype(float)
    along = np.array([-across[1], across[0]])
    d = (u - column) * across[0] + (v - row) * across[1]
    length = (u - column) * along[0] + (v - row) * along[1]
    steep = depth * (d / 3.0) * np.exp(0.5 - (d / 3.0) ** 2 / 2) * np.exp(-((length / 20.0) ** 4))
    slope = np.stack([steep * across[0], -steep * across[1]], -1)  # y of slopes is up
    size = np.sqrt(1 + (slope**2).sum(-1, keepdims=True))
    return np.asarray(np.rint(-slope / size * NORMAL_ONE), np.int16)


def energy(codes: npt.NDArray[Any], row: int, column: int, reach: int = 14) -> float:
    part = codes[row - reach : row + reach, column - reach : column + reach].astype(float) / NORMAL_ONE
    return float((part**2).sum())


def test_a_fold_across_the_compression_moves_into_its_map() -> None:
    row, column, across = place()
    codes = groove(row, column, across)
    fold = folds_in(codes, creases())
    neutral, wrinkles = unfolded(codes.copy(), fold), wrinkles_of(fold, creases())
    folded = cv2.resize(np.asarray(wrinkles[0].normal, np.float32), SIZE)
    before = energy(codes, row, column)
    assert energy(neutral, row, column) < 0.15 * before
    assert [one.name for one in wrinkles] == ["smile"] and set(wrinkles[0].units) == set(SMILE)
    assert wrinkles[0].units["mouthSmileLeft"] == pytest.approx(0.9)
    assert energy(folded, row, column) > 0.5 * before
    # Both together are the relief that was there: slopes add.
    both = slopes(neutral) + slopes(folded)
    np.testing.assert_allclose(both, slopes(codes), atol=0.05)


def slopes(codes: npt.NDArray[Any]) -> Float:
    xy = codes.astype(float) / NORMAL_ONE
    return np.asarray(-xy / np.sqrt(1 - (xy**2).sum(-1, keepdims=True)))


def test_where_nothing_is_compressed_no_texel_changes() -> None:
    codes = np.asarray(np.rint(np.random.default_rng(3).normal(0, 0.1, (*SIZE[::-1], 2)) * NORMAL_ONE), np.int16)
    albedo = np.random.default_rng(4).integers(0, 65536, (*SIZE[::-1], 3), np.uint16)
    free = np.asarray(cv2.resize(cv2.dilate(creases().weights.max(0), np.ones((5, 5))), SIZE)) == 0
    assert free.mean() > 0.5
    np.testing.assert_array_equal(unfolded(codes.copy(), folds_in(codes, creases()))[free], codes[free])
    np.testing.assert_array_equal(unfolded_albedo(albedo, creases())[free], albedo[free])


def line(row: int, column: int, across: Float) -> Float:
    """(h, w) in [0, 1], a line 12 mm long over a map."""
    v, u = np.mgrid[0 : SIZE[1], 0 : SIZE[0]].astype(float)
    d = (u - column) * across[0] + (v - row) * across[1]
    length = -(u - column) * across[1] + (v - row) * across[0]
    return np.asarray(np.exp(-((d / 3.0) ** 2)) * np.exp(-((length / 20.0) ** 4)))


def test_a_nearly_black_shadow_along_a_fold_does_not_glow() -> None:
    """Shadows on skin are dark red, as light comes through it: twice as bright in all channels they are bright red."""
    row, column, across = place()
    skin, shadow = np.array([46000.0, 34000.0, 30000.0]), np.array([20000.0, 3000.0, 5000.0])
    albedo = np.asarray(np.rint(skin + line(row, column, across)[..., None] * (shadow - skin)), np.uint16)
    made = unfolded_albedo(albedo, creases())
    assert made[..., 0].max() <= 46000 * 1.02
    left, right = made[row, column].astype(float), skin
    assert left[0] / left[1] < 1.4 * right[0] / right[1], "6.7 with one gain for all channels"
    assert (left > 0.6 * right).all()


def test_wrinkles_are_as_deep_as_their_age_and_pores_stay() -> None:
    row, column, across = place()
    codes = groove(row, column, across)
    before = energy(codes, row, column)
    deep = {age: energy(aged(codes, chart(), depth), row, column) / before for age, depth in AGES.items()}
    assert deep["none"] < 0.15 < deep["younger"] < 0.6 < deep["auto"] == 1 < 1.5 < deep["older"] < deep["old"]
    pores = np.random.default_rng(3).normal(0, 300, codes.shape).astype(np.int16)
    smooth = aged(pores, chart(), 0.0)
    assert np.abs(smooth.astype(int) - pores).mean() < 0.25 * np.abs(pores.astype(int)).mean()


@pytest.mark.parametrize("units", [{}, {"mouthSmileLeft": 0.02}, {"jawOpen": 0.04}])
def test_a_face_at_rest_folds_nothing(units: dict[str, float]) -> None:
    """Without creases no stage touches the maps, so they are the same bytes."""
    assert Creases.of(chart(), fit(units)) is None


def forms(du: tuple[float, float, float], dv: tuple[float, float, float]) -> np.ndarray:
    """(1, 1, 3) first fundamental form of a plane with these derivatives."""
    u, v = np.array(du), np.array(dv)
    return np.array([[[u @ u, u @ v, v @ v]]], np.float32)


def test_a_known_stretch_is_found_on_a_slanted_chart() -> None:
    """Squeezed to 0.7 along (cos 30, sin 30) of the surface and stretched to 1.1 across it, on a chart with shear."""
    turn = np.radians(30)
    axis = np.array([np.cos(turn), np.sin(turn)])
    normal = np.array([-axis[1], axis[0]])
    motion = 0.7 * np.outer(axis, axis) + 1.1 * np.outer(normal, normal)
    chart = np.array([[2.0, 0.6], [0.0, 1.5]])  # columns are X_u and X_v in the plane
    moved = motion @ chart
    still = forms((*chart[:, 0], 0), (*chart[:, 1], 0))
    strain = Strain.of(still, forms((*moved[:, 0], 0), (*moved[:, 1], 0)))
    stretch, across = strain.smallest()
    assert abs(stretch[0, 0] - 0.7) < 1e-5
    assert abs(abs(across[0, 0] @ axis) - 1) < 1e-5
    assert abs(strain.along(across)[0, 0] - 0.7) < 1e-5


def test_a_chart_without_area_is_still() -> None:
    strain = Strain.of(np.zeros((2, 2, 3), np.float32), np.ones((2, 2, 3), np.float32))
    stretch, across = strain.smallest()
    np.testing.assert_array_equal(stretch, 1)
    assert np.isfinite(across).all()
