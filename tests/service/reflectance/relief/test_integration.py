"""Heights from slopes."""

from __future__ import annotations

import tracemalloc

import numpy as np
import numpy.typing as npt
import pytest

from service.reflectance.relief import integration
from service.reflectance.relief.integration import MOST_STEPS, TOLERANCE, Heights, divergence, solve

Float = npt.NDArray[np.float32]


def grid(height: int, width: int) -> tuple[Float, Float]:
    y, x = np.mgrid[:height, :width].astype(np.float32)
    return x, y


def integrate(
    right: Float, down: Float, mask: npt.NDArray[np.bool_], tolerance: float = TOLERANCE, most_steps: int = MOST_STEPS
) -> Heights:
    return solve(divergence(right, down, mask), mask, tolerance=tolerance, most_steps=most_steps)


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
    """Only the mask's rectangle is worked on."""
    mask = np.zeros((300, 90), bool)
    mask[5:295, 40:80] = True  # more rows than a band
    x, y = grid(*mask.shape)
    height = np.where(mask, np.sin(x / 9) * np.cos(y / 17), 0).astype(np.float32)
    slopes = np.cos(x / 9) / 9 * np.cos(y / 17), -np.sin(x / 9) * np.sin(y / 17) / 17
    right, down = (slope.astype(np.float32) for slope in slopes)
    solved = integrate(right, down, mask, tolerance=1e-6, most_steps=60)
    assert off(solved.height, height, mask) < 0.02
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


def test_the_last_step_is_not_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """One transform there and back for each step, and none to learn what the last one left."""
    calls = []

    class Counted(integration._Rectangle):
        def __call__(self, rest: Float) -> Float:
            calls.append(1)
            return super().__call__(rest)

    monkeypatch.setattr(integration, "_Rectangle", Counted)
    x, y = grid(90, 120)
    mask = (x - 60) ** 2 + (y - 45) ** 2 < 40**2
    solved = integrate((np.cos(x / 9) / 9).astype(np.float32), 0 * y, mask)
    assert len(calls) == solved.steps > 1
    assert 0 < solved.residual <= TOLERANCE
