"""Colours of eyes, teeth and mouth, and the maps of the shape."""

from __future__ import annotations

import numpy as np
import pytest

from service.anatomy.eyes import on_eyeball, paint_eye, sight_angle
from service.anatomy.mouth import TONGUE
from service.colour import linear_to_srgb, luma, srgb_to_linear
from service.face.features.eye_colours import IRIS, SCLERA
from service.face.features.mouth import TOOTH
from service.geometry.chart import Chart
from service.texture.part_colours import LightOnParts
from service.texture.texture import shape_normals
from tests.toyhead import sphere_head

HEAD = sphere_head(24, 48)
CHART = Chart.build(HEAD, 192, 128)


def test_eye_is_painted_from_pupil_to_sclera() -> None:
    ball, points = on_eyeball(CHART, HEAD.part_names.index("eye_left"))
    angle, limbus, pupil = sight_angle(ball, points), ball.limbus_deg, ball.pupil_deg()
    assert limbus == pytest.approx(np.degrees(np.arcsin(0.00585 / 0.012)), abs=0.5)
    colour = paint_eye(angle, limbus, pupil, IRIS)
    assert np.isfinite(colour).all()
    assert (colour[angle < 0.8 * pupil].max(1) < 0.15).all()
    pale = (angle > 1.2 * limbus) & (angle < 1.6 * limbus)
    assert np.abs(colour[pale] - linear_to_srgb(SCLERA)).max() < 0.05


def test_light_of_the_parts_is_that_of_the_sclera() -> None:
    """Light is laid on and taken off once; black parts and black light stay finite."""
    nothing = np.zeros((0, 3), np.float32)
    tooth, sclera = linear_to_srgb(TOOTH), linear_to_srgb(SCLERA)
    light = LightOnParts.of(sclera * np.float32(0.5), None, nothing)
    assert np.allclose(light.on(sclera), sclera * 0.5, atol=1e-3)
    assert np.allclose(light.off(light.on(tooth)), tooth, atol=1e-3)
    grey = LightOnParts.of(None, np.array([0.5, 0.5, 0.5], np.float32), np.full((10, 3), 0.5, np.float32))
    assert np.ptp(grey.of_photo(linear_to_srgb(TONGUE))) < 1e-6
    dark = LightOnParts.of(np.zeros(3, np.float32), None, nothing)
    assert np.isfinite(dark.off(np.zeros((2, 3), np.float32))).all() and (dark.white > 0).all()


def test_what_told_no_light_is_no_sclera_to_measure_an_iris_against() -> None:
    """A squinting, dark-eyed face shows lashes and shade between its lids; its iris came out grey."""
    shown = np.array([0.13, 0.08, 0.08], np.float32)
    face = np.full((50, 3), 0.6, np.float32)
    irises = []
    for sclera in (None, np.array([0.31, 0.22, 0.22], np.float32)):
        light = LightOnParts.of(sclera, None, face)
        irises.append(float(luma(srgb_to_linear(shown) / light.white)))
    assert irises[0] < 0.03 < 0.1 < irises[1]


def test_a_nose_shows_in_the_tangent_map_and_a_plain_sphere_does_not() -> None:
    vertices = HEAD.mean.astype(float)
    skin = np.unique(HEAD.triangles[HEAD.triangle_part == 0])
    plain_map = shape_normals(CHART, vertices)[1]
    bump = np.exp(-((vertices[:, 0] / 0.02) ** 2) - ((vertices[:, 1] + 0.02) / 0.02) ** 2) * (vertices[:, 2] > -0.05)
    vertices[skin, 2] += 0.02 * bump[skin]
    inside = CHART.part == 0
    rows = np.nonzero(inside)[0]
    middle = inside & (np.abs(np.arange(128)[:, None] - np.median(rows)) < 25)
    assert plain_map[middle][:, 2].min() > 0.97
    nose = shape_normals(CHART, vertices)[1]
    column = np.arange(192)[None, :] + 0.5
    right = middle & (column > 96) & (column < 108)
    assert nose[middle][:, 2].min() < 0.95
    assert nose[right][:, 0].max() > 0.2  # its left flank (u to the right) turns towards +u
