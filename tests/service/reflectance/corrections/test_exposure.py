"""Where no eyes are seen, a light far beyond the sensor's range is doubted; a dim one is not."""

from __future__ import annotations

import numpy as np
import pytest

from service.reflectance.corrections.exposure import SHARE, USUAL, less_overexposed

LIT = np.ones((4, 6), np.float32)


def planes(value: float) -> np.ndarray:
    """Log light, a ramp round a mean."""
    ramp = np.linspace(-0.2, 0.2, 24, dtype=np.float32).reshape(4, 6)
    return np.stack([ramp + value] * 3).astype(np.float32)


def test_beyond_the_usual_a_share_is_taken_off_and_the_shape_stays() -> None:
    light = planes(0.6)
    found = less_overexposed(light, LIT)
    assert light - found == pytest.approx(SHARE * (0.6 - USUAL), abs=1e-5)


def test_underexposed_photos_keep_their_light() -> None:
    """Pulled up to the usual, an underexposed face would lose what darkness it shows a second time."""
    light = planes(-2.0)
    assert (less_overexposed(light, LIT) == light).all()


def test_twice_the_exposure_never_gives_less_light() -> None:
    means = [float(less_overexposed(planes(value), LIT).mean()) for value in np.linspace(-3, 3, 25)]
    assert (np.diff(means) > 0).all()


def test_only_lit_skin_counts_and_none_is_no_division_by_zero() -> None:
    light = planes(-1.0)
    light[:, :, 3:] = 2.0
    left = LIT.copy()
    left[:, 3:] = 0
    assert (less_overexposed(light, left) == light).all()
    assert np.isfinite(less_overexposed(light, np.zeros_like(LIT))).all()
