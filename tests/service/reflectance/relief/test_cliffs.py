"""Surfaces that are torn: least squares spreads the contradiction, the robust solution keeps it on the cliff."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from service.levels import LEVELS
from service.options import Options
from service.reflectance.reflectance_maps import unpack_normals
from service.reflectance.relief import integration as cliffs
from service.reflectance.relief.displacement import MOST_MM, Steps, displacement
from service.reflectance.relief.integration import cliff_part, integrate, integrate_robustly
from service.reflectance.translate import pack_normals

Float = npt.NDArray[np.float32]

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


def test_only_the_finest_level_keeps_cliffs() -> None:
    kept = {name: Options(quality=name).plan().keep_cliffs for name in LEVELS}  # type: ignore[arg-type]
    assert kept == {"draft": False, "standard": False, "high": False, "reference": True}
