"""Beyond what the photo shows nothing coarse is left of which a network could make a groove; the rest stays."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from service.arrays import Float32
from service.reflectance.planes import Planes
from service.reflectance.relief.normal_inputs import without_border
from service.reflectance.subject import GEOMETRY_SIZE
from service.runtime.network_registry import LIT

SIZE = (1536, 1024)
Y, X = np.mgrid[: GEOMETRY_SIZE[1], : GEOMETRY_SIZE[0]]
FROM_MIDDLE = np.hypot(X - 384, Y - 256)
FACE, EYE = 150, 20
LIT_SKIN = ((FROM_MIDDLE < FACE) & (FROM_MIDDLE > EYE)).astype(np.float32)
GRAIN = np.random.default_rng(5).normal(0, 400, SIZE[::-1])


def planes(lit: Float32) -> Planes:
    made = Planes(SIZE)
    made.add_coarse((LIT,), lit[None])
    return made


def rimmed() -> np.ndarray:
    """Skin with a dark line of 4 mm where the face ends, another tone beyond it, a dark eye, and grain all over."""
    tone = np.where(FROM_MIDDLE < FACE, 30000.0, 22000.0)
    tone -= 12000 * np.exp(-(((FROM_MIDDLE - FACE + 1) / 2) ** 2))
    tone -= 9000 * (FROM_MIDDLE < EYE)
    return np.rint(cv2.resize(tone.astype(np.float32), SIZE) + GRAIN).astype(np.uint16)


def at(low: float, high: float) -> np.ndarray:
    far = cv2.resize(FROM_MIDDLE.astype(np.float32), SIZE)
    return np.asarray((far > low) & (far < high))


def test_the_dark_line_and_the_step_go_and_the_grain_stays() -> None:
    before, after = rimmed(), without_border(rimmed(), planes(LIT_SKIN))
    coarse = cv2.GaussianBlur(after.astype(np.float32), (0, 0), 4)
    assert np.ptp(coarse[at(FACE - 30, FACE + 60)]) < 0.1 * 12000
    far = at(FACE + 20, FACE + 60)
    whole = [image.astype(np.float32) for image in (before, after)]
    fine = [image - cv2.GaussianBlur(image, (0, 0), 2) for image in whole]
    assert fine[1][far].std() == pytest.approx(fine[0][far].std(), rel=0.05)


def test_what_is_seen_stays_to_the_bit_openings_too() -> None:
    before, after = rimmed(), without_border(rimmed(), planes(LIT_SKIN))
    inside = at(-1, FACE - 20)
    assert (before[inside] == after[inside]).all()


@pytest.mark.parametrize("lit", [0.0, 1.0])
def test_nothing_changes_where_none_or_all_of_it_is_seen(lit: float) -> None:
    assert (without_border(rimmed(), planes(np.full_like(LIT_SKIN, lit))) == rimmed()).all()
    assert (without_border(rimmed(), Planes(SIZE)) == rimmed()).all()
