"""Displacement in millimetres, equal on both sides of a seam."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from service.archive.images import decode_normals8, encode_normals8
from service.geometry.chart import Chart
from service.reflectance.reflectance_maps import MID, pack_normals, unpack_normals
from service.reflectance.relief.displacement import (
    COARSEST_MM,
    MOST_MM,
    REACH_MM,
    Seams,
    Steps,
    coarse_part,
    displacement,
    encode_heights,
    join,
    slopes,
)
from service.reflectance.relief.integration import TOLERANCE, divergence, solve
from tests.toyhead import CENTRE, RADIUS, SKIN_U, sphere_head

Float = npt.NDArray[np.float32]

WIDTH, HEIGHT = 300, 200
MM = 0.08
"""Side of a texel: 24 mm x 16 mm of skin."""

ALL = np.ones((HEIGHT, WIDTH), bool)


def steps(along: float = MM, across: float = MM, lean: float = 0.0) -> Steps:
    one = np.ones((HEIGHT, WIDTH), np.float32)
    return Steps(np.float32(along) * one, np.float32(lean) * one, np.float32(across) * one, WIDTH)


def places(along: float = MM, across: float = MM, lean: float = 0.0) -> tuple[Float, Float]:
    """Position along t and along b (mm) of each texel; rows go down, b goes up."""
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    up = HEIGHT / 2 - row
    return (column * along + up * lean).astype(np.float32), (up * across).astype(np.float32)


def pores(t: Float, b: Float, seed: int = 0, count: int = 60) -> tuple[Float, Float, Float]:
    """Pits of 20 to 60 um and 0.3 to 0.6 mm: height and its slopes along t and b."""
    rng = np.random.default_rng(seed)
    height, along, across = (np.zeros_like(t) for _ in range(3))
    for _ in range(count):
        ct, cb = rng.uniform(t.min(), t.max()), rng.uniform(b.min(), b.max())
        depth, width = rng.uniform(0.02, 0.06), rng.uniform(0.3, 0.6)
        pit = -depth * np.exp(-((t - ct) ** 2 + (b - cb) ** 2) / width**2)
        height += pit
        along += pit * -2 * (t - ct) / width**2
        across += pit * -2 * (b - cb) / width**2
    return height, along, across


def codes(along: Float, across: Float) -> npt.NDArray[np.int16]:
    return pack_normals(-along, -across, np.ones_like(along))


def fine(height: Float, of: Steps) -> Float:
    return height - coarse_part(height, ALL, of)


def error(found: Float, height: Float, of: Steps) -> float:
    """Rms in mm of what is left after the coarse part of the truth is gone too."""
    return float(np.sqrt(np.mean((found - fine(height, of)) ** 2)))


def test_relief_comes_back_and_a_pore_is_a_pit() -> None:
    """A flipped sign or a swapped axis anywhere between normal and height makes pores bumps, or waves."""
    height, along, across = pores(*places())
    found, facts = displacement(codes(along, across), steps(), ALL)
    assert error(found, height, steps()) < 0.05 * height.std()
    pit = np.unravel_index(height.argmin(), height.shape)
    assert found[pit] < -0.015
    assert facts.ignored_fraction == 0 and facts.residual <= TOLERANCE


@pytest.mark.parametrize("metric", [(0.04, 0.08, 0.0), (0.08, 0.05, 0.0), (0.06, 0.06, 0.03)])
def test_the_metric_counts(metric: tuple[float, float, float]) -> None:
    """Stretched and sheared charts; read as square, a stretch of two would double the heights along one axis."""
    height, along, across = pores(*places(*metric))
    found, _ = displacement(codes(along, across), steps(*metric), ALL)
    assert error(found, height, steps(*metric)) < 0.08 * height.std()
    wrong, _ = displacement(codes(along, across), steps(), ALL)
    assert error(wrong, height, steps(*metric)) > 0.2 * height.std()


def test_the_metric_of_a_sphere_is_known() -> None:
    """Steps along a latitude-longitude chart: R cos(latitude) d(longitude) and R d(latitude)."""
    head = sphere_head(24, 48)
    chart = Chart.build(head, 192, 128)
    found = Steps.of(chart, head.mean)
    skin = chart.part == 0
    position = chart.interpolate(head.mean)
    cosine = np.hypot(position[..., 0] - CENTRE[0], position[..., 2] - CENTRE[2]) / RADIUS
    inner = skin & (cosine > 0.5)
    wide, tall = 0.96 * 192 / (2 * np.pi), 0.71 * 128 / np.pi
    # The metric is constant on a triangle, so single texels are off.
    assert np.median(np.abs(found.along * wide / (1000 * RADIUS * cosine) - 1)[inner]) < 0.04
    assert np.median(np.abs(found.across * tall / (1000 * RADIUS) - 1)[inner]) < 0.02
    assert np.abs(found.lean[inner]).max() < 0.1 * 1000 * RADIUS / tall


def test_one_percent_of_unusable_normals() -> None:
    """NaN, zeros, wrong lengths: believed, a single NaN would make all heights NaN, a zero a cliff."""
    height, along, across = pores(*places())
    normals = unpack_normals(codes(along, across))
    rng = np.random.default_rng(3)
    for value in (np.nan, np.inf, 0.0, 1.5):
        normals[rng.random(ALL.shape) < 0.0025] = value
    s, t, usable = slopes(normals)
    assert np.isfinite(s).all() and np.isfinite(t).all()
    assert 0.008 < 1 - usable.mean() < 0.012
    solved = solve(divergence(s * MM, -t * MM, usable), usable, tolerance=1e-3, most_steps=40)
    clean, _ = displacement(codes(along, across), steps(), ALL)
    broken = fine(solved.height, steps())[usable]
    assert np.sqrt(np.mean((broken - fine(height, steps())[usable]) ** 2)) < 2 * error(clean, height, steps()) + 1e-3


def test_grazing_normals_are_held_at_eighty_degrees() -> None:
    """z = 0 would divide by zero and z < 0 turn the slope around; 80 degrees is a slope of 5.7."""
    normals = np.zeros((1, 4, 3), np.float32)
    normals[0] = np.array([[1, 0, 0], [0.999, 0, -0.04], [np.cos(0.05), 0, np.sin(0.05)], [0, -1, 0]])
    s, t, usable = slopes(normals)
    assert usable.all()
    np.testing.assert_allclose(s[0, :3], -np.sqrt(1 - 0.17**2) / 0.17, rtol=2e-2)
    np.testing.assert_allclose(t[0, 3], 5.8, rtol=2e-2)


def test_a_cliff_stays_local_and_within_the_clamp() -> None:
    """A step of 3 mm between two texels, which normals cannot show: what it does must stay near it."""
    height, along, across = pores(*places())
    along[:, WIDTH // 2] = 40.0
    found, _ = displacement(codes(along, across), steps(), ALL)
    assert np.abs(found).max() <= MOST_MM
    away = np.abs(np.arange(WIDTH) - WIDTH // 2) * MM > 2 * COARSEST_MM - 2
    gap = (found - fine(height, steps()))[:, away]
    assert np.sqrt(np.mean((gap - gap.mean()) ** 2)) < 0.02


def test_flat_normals_in_eight_bits_stay_flat() -> None:
    """Coded as n/2 + 1/2 over 255, zero would decode to a slope of 0.004: a ramp of 0.1 mm over this patch."""
    flat = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    flat[..., 2] = 1
    decoded = decode_normals8(encode_normals8(flat))
    found, _ = displacement(pack_normals(*np.moveaxis(decoded, 2, 0)), steps(), ALL)
    assert np.abs(found).max() == 0
    assert (encode_heights(found) == MID).all()


SIZE = (384, 256)


@pytest.fixture(scope="module")
def chart() -> Chart:
    return Chart.build(sphere_head(), *SIZE)


def test_sides_meet_and_nothing_changes_further_away(chart: Chart) -> None:
    """A slope over the chart of 2 mm: at the cut it would be a wall of 2 mm."""
    mask = chart.part == 0
    seams = Seams.of(chart.head, 0, mask)
    wall = np.where(mask, np.linspace(-1, 1, SIZE[0], dtype=np.float32), 0).astype(np.float32)
    assert np.abs(wall.ravel()[seams.one] - wall.ravel()[seams.other]).max() > 1.8
    fine = Steps.of(chart, chart.head.mean).texel_mm() * np.float32(0.1)  # a head so small that texels are fine
    joined = wall.copy()
    join(joined, seams, mask, fine)
    step = np.abs(joined.ravel()[seams.one] - joined.ravel()[seams.other])
    row = seams.one // SIZE[0]
    assert step[(row > 20) & (row < 160)].max() < 0.010
    columns = np.arange(SIZE[0])
    far = (columns > SKIN_U[0] * SIZE[0] + 2 * REACH_MM / fine.min()) & (columns < SIZE[0] / 2)
    np.testing.assert_array_equal(joined[70:110, far], wall[70:110, far])
    assert not np.isnan(joined).any()
    assert (joined[~mask] == wall[~mask]).all()


def test_a_part_without_cuts_and_an_empty_mask(chart: Chart) -> None:
    teeth = chart.head.part_names.index("teeth_upper")
    seams = Seams.of(chart.head, teeth, chart.part == teeth)
    assert len(seams.one) == 0
    flat = np.zeros(SIZE[::-1], np.float32)
    join(flat, seams, chart.mask, np.ones((2, 3), np.float32))
    assert not flat.any()
    assert len(Seams.of(chart.head, 0, np.zeros(SIZE[::-1], bool)).one) == 0


def test_a_strip_one_texel_wide_is_harmless() -> None:
    mask = np.zeros_like(ALL)
    mask[100], mask[20, 20] = True, True
    slope = np.full(ALL.shape, 0.2, np.float32)
    found, _ = displacement(codes(slope, slope), steps(), mask)
    assert np.isfinite(found).all() and np.abs(found).max() <= MOST_MM
