"""The tint of the light, between the network's and that of the whites of the eyes."""

from __future__ import annotations

import numpy as np
import pytest

from service.head.files import load_head
from service.reflectance.subject import Subject
from service.reflectance.tint import LARGEST, SHARE, tint_of_whites
from tests.service.reflectance.toys import toy_subject

LIDS = np.zeros((8, 12), np.float32)
LIDS[3:5, 4:8] = 0.7


def light(tint: tuple[float, float, float]) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Light that differs over the face, and has a tint and a strength of -0.5 on the lids."""
    slope = np.linspace(-0.3, 0.3, 12, dtype=np.float32) - np.float32(np.linspace(-0.3, 0.3, 12)[4:8].mean())
    base = np.array(tint, np.float32) - np.float32(np.mean(tint))
    return np.asarray(base[:, None, None] - 0.5 + slope[None, None] + np.zeros((3, 8, 12)), np.float32)


def on_lids(values: np.ndarray) -> np.ndarray:
    return np.asarray((values * LIDS).sum((1, 2)) / LIDS.sum())


def test_half_way_to_the_whites_and_as_strong() -> None:
    """Blue light on pink skin, says the network; grey light, say the whites. Shape and strength stay."""
    found = light((-0.1, 0.0, 0.1))
    mended = tint_of_whites(found, np.array([-0.9, -0.9, -0.9, 1.0]), LIDS)
    np.testing.assert_allclose(on_lids(mended), -0.5 + (1 - SHARE) * np.array([-0.1, 0.0, 0.1]), atol=1e-5)
    change = mended - found
    assert np.ptp(change, axis=(1, 2)).max() < 1e-5, "the same all over"


def test_whites_that_contradict_move_it_by_a_bound() -> None:
    """A lid taken for a white is red: it must not turn the face blue."""
    found = light((0.0, 0.0, 0.0))
    mended = tint_of_whites(found, np.array([1.0, -1.5, -3.0, 1.0]), LIDS)
    assert np.abs(mended - found).max() <= 2 * LARGEST and np.isfinite(mended).all()


@pytest.mark.parametrize("known", [True, False])
def test_without_whites_or_lids_the_light_stays(known: bool) -> None:
    """Division by the weight of no lids would be NaN all over the face."""
    found = light((-0.1, 0.0, 0.1))
    eyes = np.array([-0.2, -0.5, -0.9, float(known)])
    weights = np.zeros_like(LIDS) if known else LIDS
    assert np.array_equal(tint_of_whites(found, eyes, weights), found)


def test_lids_of_the_head() -> None:
    """Both eyes' on the head in the box, none on one without such regions."""
    head = load_head()
    lids = Subject.of(head, head.mean).lids
    half = lids.shape[1] // 2
    assert lids[:, :half].sum() == pytest.approx(lids[:, half:].sum(), rel=0.02) and lids.min() >= 0
    assert lids.max() > 0.5 and not toy_subject().lids.any()
