"""Teeth, gums, tongue and lining: measured where they show, dark further in, and no division by nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.anatomy.canvas import PartTexels, part_points
from service.anatomy.mouth_painting import (
    WHITEST,
    WIDTHS_MM,
    Teeth,
    along_arch,
    biting_height,
    crown_share,
    draw_teeth,
    no_bluer,
    paint_lining,
    paint_tongue,
)
from service.colour import FULL_CODE, linear_to_srgb, srgb_to_linear
from service.face.features.mouth import TOOTH
from service.geometry.chart import Chart
from service.head.files import load_head
from tests.toyhead import sphere_head

UP = np.array([0.0, 1.0, 0.0])
TEETH = linear_to_srgb(TOOTH)


@pytest.fixture(scope="module")
def chart() -> Chart:
    return Chart.build(load_head(), 576, 384)


def test_crowns_end_a_centimetre_from_the_biting_edge() -> None:
    """Of both rows, whatever height the edge has: lower molars bite above lower incisors."""
    x = np.linspace(-0.02, 0.02, 9)
    edge = np.stack([x, -0.06 + 10 * x**2, np.zeros(9)], 1)
    for upper, sign in ((True, 1.0), (False, -1.0)):
        near, far = edge + sign * 0.005 * UP, edge + sign * 0.013 * UP
        vertices = np.concatenate([edge, far])
        assert (crown_share(near, vertices, upper=upper)[1:-1] == 1).all()
        assert (crown_share(far, vertices, upper=upper)[3:6] == 0).all()
    alone = crown_share(np.array([[1.0, 0, 0]]), edge, upper=True)
    assert np.isfinite(alone).all()


def test_the_mouth_grows_dark_inwards(chart: Chart) -> None:
    teeth = Teeth(chart)
    painted = teeth.paint(TEETH)
    front, back = (teeth.depth < 0.006) & (teeth.crown > 0.9), teeth.depth > 0.035
    assert np.abs(painted[front] - TEETH).max() < 0.1
    assert painted[back].max() < 0.5
    index = chart.head.part_names.index("tongue")
    own = np.flatnonzero(chart.inner_part == index)
    tongue = paint_tongue(chart, index, own)
    z, _ = part_points(chart, index, own)
    assert tongue[z[:, 2] > -0.002].mean() > 2 * tongue[z[:, 2] < -0.04].mean()


def test_a_head_without_teeth_or_mouth_is_no_trouble() -> None:
    toy = Chart.build(sphere_head(12, 24), 96, 64)
    lining = paint_lining(toy, np.zeros(len(toy.texels), np.float32))
    assert np.isfinite(lining).all()
    assert np.isfinite(Teeth(toy).paint(TEETH)).all()


def test_teeth_do_not_turn_cyan_by_the_light_of_redder_eyes() -> None:
    """Without the bound, overexposed teeth divided by warm light have more blue than red; others stay as they are."""
    albedo = np.array([[0.8, 0.9, 1.0], [0.8, 0.72, 0.6], [0.0, 0.0, 0.0]], np.float32)
    kept = no_bluer(albedo)
    bare = srgb_to_linear(kept)
    assert (bare[0, 1:] <= bare[0, 0] * np.array(WHITEST) + 1e-4).all()
    assert kept[0, 0] == pytest.approx(0.8, abs=1e-4), "red stays"
    assert kept[1:] == pytest.approx(albedo[1:], abs=1e-4)


def test_gaps_and_shadows_are_not_printed_on_the_teeth(chart: Chart) -> None:
    teeth = Teeth(chart)
    colour = np.array([[0.8, 0.75, 0.65], [0.2, 0.1, 0.1], [0.0, 0.0, 0.0]], np.float32)
    assert np.allclose(teeth.shows(colour, colour[0]), [1, 0, 0])
    assert np.isfinite(teeth.shows(colour, np.zeros(3, np.float32))).all()


HEAD = load_head()
SIZE = (3072, 2048)


def test_an_arch_is_measured_along_its_curve() -> None:
    """Against the closed form of a parabola's length; straight from side to side, molars would be a millimetre wide."""
    k, x = 20.0, np.linspace(-0.025, 0.025, 101)
    row = np.stack([x, 0 * x, 0.05 - k * x * x], 1)
    slope = 2 * k * x
    exact = (slope * np.sqrt(1 + slope**2) + np.arcsinh(slope)) / (4 * k)
    assert np.abs(along_arch(row, row) - 1e3 * exact).max() < 0.15
    assert np.isfinite(along_arch(row[:1], row[:1])).all()


@pytest.mark.parametrize("name", list(WIDTHS_MM))
def test_there_are_as_many_gaps_as_teeth_and_they_are_where_teeth_end(name: str) -> None:
    white = np.full((SIZE[1], SIZE[0], 3), round(0.8 * FULL_CODE), np.uint16)
    after = draw_teeth(white.copy(), HEAD) / FULL_CODE
    place = PartTexels.of(HEAD, name, SIZE)
    assert place is not None
    along = along_arch(place.points, place.vertices)
    height = 1e3 * biting_height(place.points, place.vertices, upper=name == "teeth_upper")
    shown = after[place.box][place.inside][:, 1]
    band = (height > 1.5) & (height < 5)
    bins = np.arange(-24, 24, 0.5)
    profile = np.array([shown[band & (np.abs(along - b) < 0.3)].mean() for b in bins])
    dips = bins[1:-1][(profile[1:-1] < profile[:-2]) & (profile[1:-1] <= profile[2:]) & (profile[1:-1] < 0.74)]
    borders = np.cumsum(WIDTHS_MM[name])
    borders = np.concatenate([-borders[::-1], [0.0], borders])
    borders = borders[np.abs(borders) < 23.5]
    assert len(dips) == len(borders)
    assert np.abs(dips - borders).max() < 0.6
    assert 0.7 < np.median(shown[band]) <= 0.8 and after.max() <= 0.8001
    elsewhere = np.ones(after.shape[:2], bool)
    for row in WIDTHS_MM:
        other = PartTexels.of(HEAD, row, SIZE)
        assert other is not None
        elsewhere[other.box] &= ~other.inside
    assert (after[elsewhere] == white[elsewhere] / FULL_CODE).all()


def test_detail_is_as_strong_as_asked_and_no_teeth_are_no_error() -> None:
    white = np.full((512, 768, 3), 50000, np.uint16)
    assert np.abs(draw_teeth(white.copy(), HEAD, 0.0).astype(int) - white).max() <= 1
    half, full = (draw_teeth(white.copy(), HEAD, detail).astype(int) for detail in (0.5, 1.0))
    assert full.sum() < half.sum() < white.sum()
    without = replace(HEAD, part_names=tuple(f"other_{i}" for i, _ in enumerate(HEAD.part_names)))
    assert np.array_equal(draw_teeth(white.copy(), without), white)
    tiny = np.full((8, 12, 3), 50000, np.uint16)
    assert draw_teeth(tiny, HEAD).shape == (8, 12, 3)
