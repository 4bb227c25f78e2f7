"""Seams between seen and unseen skin, on charts whose step is known."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")

from benchmarks.unseen_skin import Steps, bands, row

SHAPE = (128, 192)


def halves() -> tuple[np.ndarray, np.ndarray]:
    seen = np.zeros(SHAPE, bool)
    seen[:, :96] = True
    return seen, np.ones(SHAPE, bool)


def painted(seen: np.ndarray, left: float, right: float) -> np.ndarray:
    return np.asarray(np.where(seen[..., None], left, right) * np.array([1.0, 0.75, 0.6]))


def test_bands_lie_side_by_side_and_not_on_the_border() -> None:
    seen, skin = halves()
    unseen, beside, further = bands(seen, skin)
    assert unseen.any() and not (unseen & seen).any() and (beside & seen).sum() == beside.sum()
    assert not (beside & further).any()
    assert not unseen[:, 96:98].any() and not beside[:, 94:96].any(), "both sides are blended there"


def test_a_step_of_brightness_is_found_and_is_no_step_of_hue() -> None:
    seen, skin = halves()
    unseen, beside, further = bands(seen, skin)
    albedo = painted(seen, 0.6, 0.5)
    across, control = Steps.between(albedo, unseen, beside), Steps.between(albedo, beside, further)
    assert across.delta_e.min() > 5 and control.delta_e.max() < 1e-6
    assert across.hue.max() < across.delta_e.max()


def test_a_step_of_hue_is_told_apart() -> None:
    seen, skin = halves()
    unseen, beside, _ = bands(seen, skin)
    grey = np.where(seen[..., None], [0.6, 0.45, 0.36], [0.48, 0.48, 0.48])
    assert Steps.between(grey, unseen, beside).hue.min() > 10


def test_no_border_gives_a_row_without_numbers() -> None:
    seen, skin = np.ones(SHAPE, bool), np.ones(SHAPE, bool)
    unseen, beside, further = bands(seen, skin)
    albedo = painted(seen, 0.5, 0.5)
    across, control = Steps.between(albedo, unseen, beside), Steps.between(albedo, beside, further)
    assert not len(across.delta_e)
    assert row("whole", across, control) == "| whole | 0 | - | - | - | - | - |"


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_bands_of_all_or_nothing_are_empty(share: float) -> None:
    seen = np.full(SHAPE, share > 0.5)
    assert not bands(seen, np.ones(SHAPE, bool))[0].any()
