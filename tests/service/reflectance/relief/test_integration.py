"""Heights from slopes, and cliffs in them."""

from __future__ import annotations

import tracemalloc

import numpy as np
import numpy.typing as npt
import pytest

from service.reflectance.reflectance_maps import unpack_normals
from service.reflectance.relief import integration as cliffs
from service.reflectance.relief.displacement import MOST_MM, Steps, displacement
from service.reflectance.relief.integration import Edges, cliff_part, integrate, integrate_robustly
from service.reflectance.translate import pack_normals

Float = npt.NDArray[np.float32]


def grid(height: int, width: int) -> tuple[Float, Float]:
    y, x = np.mgrid[:height, :width].astype(np.float32)
    return x, y


def off(a: Float, b: Float, mask: npt.NDArray[np.bool_]) -> float:
    """Largest difference within a mask after each of its regions has lost its mean difference."""
    from scipy.ndimage import label

    regions, count = label(mask)
    gap = a - b
    return max(float(np.abs(gap[regions == i] - gap[regions == i].mean()).max()) for i in range(1, count + 1))


@pytest.mark.parametrize("shape", [(40, 60), (1, 50), (50, 1), (37, 53)])
def test_a_quadratic_is_exact(shape: tuple[int, int]) -> None:
    """Slopes averaged to the middle of an edge are exact for it; one-sided ones are off by half a texel's change."""
    x, y = grid(*shape)
    height = 0.01 * x * x - 0.02 * x * y + 0.3 * y
    solved = integrate(0.02 * x - 0.02 * y, -0.02 * x + 0.3, np.ones(shape, bool), tolerance=1e-6)
    assert off(solved.height, height, np.ones(shape, bool)) < 2e-3 * np.ptp(height)
    assert abs(float(solved.height.mean())) < 1e-3


def test_nothing_is_asked_across_the_border_of_a_mask() -> None:
    """A disc and a bar with a hole: right inside although outside there is nonsense, and independent of each other."""
    x, y = grid(80, 120)
    disc = (x - 35) ** 2 + (y - 40) ** 2 < 30**2
    bar = (np.abs(x - 95) < 15) & (np.abs(y - 40) < 35) & ((x - 95) ** 2 + (y - 40) ** 2 > 36)
    mask = disc | bar
    height = np.sin(x / 9) * np.cos(y / 7)
    right, down = np.cos(x / 9) / 9 * np.cos(y / 7), -np.sin(x / 9) * np.sin(y / 7) / 7
    junk = np.random.default_rng(0).normal(0, 50, mask.shape)
    junk[0, 0] = np.nan
    wanted = [np.where(mask, slope, junk).astype(np.float32) for slope in (right, down)]
    solved = integrate(wanted[0], wanted[1], mask, tolerance=1e-5, most_steps=60)
    assert off(solved.height, height.astype(np.float32), mask) < 0.02
    assert (solved.height[~mask] == 0).all()


@pytest.mark.parametrize("count", [0, 1])
def test_masks_with_no_edge(count: int) -> None:
    mask = np.zeros((5, 7), bool)
    mask.ravel()[:count] = True
    solved = integrate(np.ones((5, 7), np.float32), np.ones((5, 7), np.float32), mask)
    assert (solved.height == 0).all()
    assert solved.steps == 0


def test_a_mask_in_a_corner_of_a_large_map() -> None:
    """Only the mask's rectangle is worked on: weights and initial heights of the whole map are cut with it."""
    mask = np.zeros((300, 90), bool)
    mask[5:295, 40:80] = True  # more rows than a band
    x, y = grid(*mask.shape)
    height = np.where(mask, np.sin(x / 9) * np.cos(y / 17), 0).astype(np.float32)
    slopes = np.cos(x / 9) / 9 * np.cos(y / 17), -np.sin(x / 9) * np.sin(y / 17) / 17
    right, down = (slope.astype(np.float32) for slope in slopes)
    weights = np.random.default_rng(0).uniform(0.5, 1.0, mask.shape).astype(np.float32)
    edges = Edges(weights[:, 1:], weights[1:])
    solved = integrate(right, down, mask, tolerance=1e-6, most_steps=60, edges=edges)
    assert off(solved.height, height, mask) < 0.02
    again = integrate(right, down, mask, edges=edges, start=solved.height)
    assert off(again.height, solved.height, mask) < 1e-3
    assert (solved.height[~mask] == 0).all()


def test_few_planes_are_held_at_once() -> None:
    """At 6144 x 4096 a plane takes 100 MB, and the solver is where an avatar takes the most."""
    shape = (1024, 768)
    slope = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    mask = np.ones(shape, bool)
    integrate(slope, slope, mask)  # imports
    tracemalloc.start()
    integrate(slope, slope, mask)
    most = tracemalloc.get_traced_memory()[1] / slope.nbytes
    tracemalloc.stop()
    assert most < 5.2, "6.0 with planes of edges"


TALL, WIDE, MM = 160, 220, 0.28


def torn(jump_mm: float, noise: float = 0.0) -> tuple[Float, Float, Float, Float]:
    """Height of relief that is torn along a column, by most in the middle; its slopes; distance in mm from the tear.

    The jump is exp(-(y / 4 mm)^2) times ``jump_mm``, to the right of the tear only: slopes do not show it, and no
    continuous surface has them.
    """
    row, column = np.mgrid[:TALL, :WIDE]
    y, x = (row - TALL / 2) * MM, (column + 0.5 - WIDE // 2) * MM
    jump = jump_mm * np.exp(-((y / 4) ** 2)) * (x > 0)
    relief = 0.05 * np.sin(2 * x) * np.sin(1.5 * y)
    along, down = 0.1 * np.cos(2 * x) * np.sin(1.5 * y), 0.075 * np.sin(2 * x) * np.cos(1.5 * y) - y / 8 * jump
    rng = np.random.default_rng(2)
    right, below = ((slope + rng.normal(0, noise, y.shape)) * MM for slope in (along, down))
    planes = (jump + relief, right, below, np.abs(x))
    return tuple(np.asarray(plane, np.float32) for plane in planes)  # type: ignore[return-value]


ALL = np.ones((TALL, WIDE), bool)
TEXEL = np.full((TALL, WIDE), MM, np.float32)


def rms_um(found: Float, height: Float, where: npt.NDArray[np.bool_]) -> float:
    gap = found - height
    return float(1000 * np.sqrt(np.square((gap - np.median(gap))[where]).mean()))


@pytest.mark.parametrize(("jump", "noise", "near", "away"), [(0.6, 0.0, 2.0, 4.0), (0.6, 0.02, 2.0, 3.5)])
def test_a_tear_stays_where_it_is(jump: float, noise: float, near: float, away: float) -> None:
    """Least squares raises and lowers whole regions at both sides; so many times less is left, near and away."""
    height, right, down, distance = torn(jump, noise)
    plain = integrate(right, down, ALL).height
    found = integrate_robustly(right, down, ALL, TEXEL, plain)
    for where, gain in ((distance < 1, near), (distance > 3, away)):
        assert rms_um(found.height, height, where) < rms_um(plain, height, where) / gain
    assert 0 < found.cut < 0.02


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.06])
def test_a_whole_surface_is_not_torn(noise: float) -> None:
    """Noise of one and of three degrees: taken for cliffs it would be let through instead of averaged."""
    height, right, down, _ = torn(0.0, noise)
    plain = integrate(right, down, ALL).height
    found = integrate_robustly(right, down, ALL, TEXEL, plain)
    assert rms_um(found.height, height, ALL) < 1.1 * rms_um(plain, height, ALL) + 0.2
    assert found.cut < 0.02 if noise else found.cut == 0


def test_a_constant_map_is_left_alone() -> None:
    """No residual has a scale to be measured by."""
    flat = np.zeros_like(TEXEL)
    found = integrate_robustly(flat, flat, ALL, TEXEL, flat)
    assert not found.height.any() and (found.rounds, found.cut) == (1, 0.0)


@pytest.mark.parametrize("count", [0, 1])
def test_masks_without_an_equation(count: int) -> None:
    mask = np.zeros_like(ALL)
    mask.ravel()[:count] = True
    gained, cut = cliff_part(TEXEL, TEXEL, mask, TEXEL)
    assert not gained.any() and cut == 0


def test_unusable_and_grazing_normals_do_not_break_it() -> None:
    """NaN, zeros and normals in the surface on two percent of the map: heights are finite and held to a millimetre."""
    _, right, down, _ = torn(0.6)
    codes = pack_normals(-right / MM, down / MM, np.ones_like(right))
    normals = unpack_normals(codes)
    rng = np.random.default_rng(5)
    for vector in ([np.nan, 0, 1], [0, 0, 0], [1, 0, 0], [0, 1, 1e-9]):
        normals[rng.random(ALL.shape) < 0.005] = vector
    one = np.ones((TALL, WIDE), np.float32)
    steps = Steps(MM * one, 0 * one, MM * one, WIDE)
    found, facts = displacement(pack_normals(*np.moveaxis(normals, 2, 0)), steps, ALL, keep_cliffs=True)
    assert np.isfinite(found).all() and np.abs(found).max() <= MOST_MM
    assert facts.cut_fraction is not None and 0 < facts.cut_fraction < 0.1
    assert displacement(codes, steps, ALL)[1].cut_fraction is None


def test_a_map_wider_than_it_is_solved_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same tear on 4 times as many texels, with nonsense outside the mask: the correction is the same.

    The solution is made 200 texels wide here, so that a small map is 2.2 times as wide as it.
    """
    height, right, down, distance = torn(0.6)
    fine = [np.repeat(np.repeat(plane, 2, 0), 2, 1) for plane in (height, right / 2, down / 2, distance)]
    mask = np.ones(fine[0].shape, bool)
    mask[:, -23:] = False  # ends within a texel of the solution
    monkeypatch.setattr(cliffs, "WIDTH", 200)
    assert fine[0].shape[-1] > 2 * cliffs.WIDTH
    slopes = [np.where(mask, slope, 9.0).astype(np.float32) for slope in fine[1:3]]
    gained, _ = cliffs.cliff_part(slopes[0], slopes[1], mask, TEXEL / np.float32(2))
    assert not gained[~mask].any()
    whole = ALL & (np.arange(WIDE) < WIDE - 12)
    plain = integrate(right, down, whole).height
    for where, gain in ((distance < 1, 2.0), (distance > 3, 3.0)):
        left = plain + gained.reshape(TALL, 2, WIDE, 2).mean((1, 3))
        assert rms_um(left, height, where & whole) < rms_um(plain, height, where & whole) / gain
