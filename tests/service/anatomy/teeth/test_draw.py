"""Rows of teeth are parted into teeth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.anatomy.part_texels import PartTexels
from service.anatomy.teeth.draw import WIDTHS_MM, along_arch, draw_teeth
from service.anatomy.teeth.paint import biting_height
from service.colour import FULL_CODE
from service.head.files import load_head

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
