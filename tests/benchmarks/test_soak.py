"""What counts as growth."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.soak import growth, slope


def series(values: np.ndarray) -> list[tuple[float, float]]:
    """One look every quarter of a minute."""
    return [(number / 240, float(value)) for number, value in enumerate(values)]


def test_a_line_has_its_slope_whatever_one_point_says() -> None:
    points = series(3.0 * np.arange(100) / 240)
    points[50] = (points[50][0], 1e6)
    assert slope(points) == pytest.approx(3.0)


@pytest.mark.parametrize("points", [[], [(0.0, 1.0)], [(0.5, 1.0), (0.5, 9.0)]])
def test_no_line_is_no_slope(points: list[tuple[float, float]]) -> None:
    """A run that ends at once, or a clock that did not move, must not divide by zero."""
    assert slope(points) == 0.0


def test_warming_up_and_noise_are_no_growth_and_a_leak_is() -> None:
    moments = np.arange(240)
    noise = np.random.default_rng(1).normal(0, 0.5, 240)
    warm = 80 - 30 * np.exp(-moments / 10) + noise
    leak = 80 + 12 * moments / 240 + noise
    found = growth({"server mb": series(warm), "worker mb": series(leak), "server fds": series(np.full(240, 16.0))})
    assert {name: facts["grows"] for name, facts in found.items()} == {
        "server mb": False, "worker mb": True, "server fds": False,
    }  # fmt: skip
    assert found["worker mb"]["rise_per_hour"] == pytest.approx(12, abs=1)


def test_a_file_that_stays_open_now_and_then_is_growth() -> None:
    assert growth({"server fds": series(16.0 + np.arange(240) // 40)})["server fds"]["grows"]
