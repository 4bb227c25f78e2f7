"""Limits are checked against nonsense and against each other."""

from __future__ import annotations

import math

import pytest

from service.errors import TooManyPixels, UsageError
from service.photo.limits import Limits, check_size


@pytest.mark.parametrize(
    "changes",
    [
        {"max_bytes": 0},
        {"min_side": -1},
        {"max_aspect": 0.5},
        {"max_aspect": math.nan},
        {"wall_seconds": math.inf},
        {"wall_seconds": 0},
        {"cpu_seconds": 0},
        {"memory_bytes": 2**63},
        {"min_side": 500, "max_side": 400},
        {"min_side": 500, "max_pixels": 400},
    ],
)
def test_limits_that_make_no_sense(changes: dict[str, int]) -> None:
    with pytest.raises(UsageError):
        Limits(**changes)


@pytest.mark.parametrize("size", [(8000, 8000), (12_000, 5333), (64, 64), (64, 384), (384, 64)])
def test_sizes_on_the_bounds_pass(size: tuple[int, int]) -> None:
    check_size(*size, Limits())


@pytest.mark.parametrize("size", [(8001, 8000), (12_001, 4000)])
def test_sizes_past_the_bounds_fail(size: tuple[int, int]) -> None:
    with pytest.raises(TooManyPixels):
        check_size(*size, Limits())
