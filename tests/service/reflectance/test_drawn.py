"""Which detail super-resolution drew: what rho and sigma are told."""

from __future__ import annotations

import numpy as np
import pytest

from service.reflectance.relief.normal_inputs import drawn_detail
from service.reflectance.subject import GEOMETRY_SIZE
from service.texture.photo_detail import Octave

HALF = np.repeat(np.array([[1, 0]], np.float32), 288, 1)[[0] * 384]
"""A photo that shows the left half of a texture of 576 x 384."""


def octaves(*shares: float) -> list[Octave]:
    return [Octave(0.13 * 2**k, 0.27 * 2**k, share) for k, share in enumerate(shares)]


def test_a_resampled_texture_has_no_drawn_detail() -> None:
    assert (drawn_detail(HALF, octaves(0, 0), 0.0) == -1).all()
    assert (drawn_detail(None, (), 0.0) == -1).all()


def test_without_a_photo_all_detail_is_drawn() -> None:
    drawn = drawn_detail(None, (), 1.0)
    assert drawn.shape == GEOMETRY_SIZE[::-1] and (drawn == 1).all()
    assert (drawn_detail(HALF, (), 1.0) == 1).all(), "a photo of which nothing was brought onto the map"


def test_less_drawn_detail_is_told_as_less() -> None:
    """``--detail 0.5`` makes pores half as deep in the colour; relief at full strength would not belong to them."""
    assert (drawn_detail(None, (), 0.5) == 0).all()


def test_a_sharp_photo_draws_its_own_skin_and_no_more() -> None:
    """Else rho would read relief off the pigment of the one, and leave the other without pores."""
    drawn = drawn_detail(HALF, octaves(1, 1, 1, 1, 1), 1.0)
    width = GEOMETRY_SIZE[0]
    assert (drawn[:, : width // 2 - 2] == -1).all() and (drawn[:, width // 2 + 2 :] == 1).all()


@pytest.mark.parametrize("shares", [(0.0, 0.0, 0.2, 0.8, 1.0), (0.1, 0.9), (0.5,)])
def test_a_soft_photo_lies_between(shares: tuple[float, ...]) -> None:
    """Less of what is fine is the photo's than of what is coarse; fine octaves hold most of the relief."""
    left = drawn_detail(HALF, octaves(*shares), 1.0)[:, 5]
    assert ((left > -1) & (left < 1)).all()
    assert len(shares) == 1 or (1 - left.mean()) / 2 < np.mean(shares) + 1e-6


def test_shares_out_of_range_stay_in_it() -> None:
    """NaN in the photo's opacity or a share beyond 1 would reach a network that was taught [-1, 1]."""
    broken = np.full_like(HALF, np.nan)
    for seen, told in ((HALF * 3, octaves(2.0, 2.0)), (broken, octaves(1.0, 1.0))):
        drawn = drawn_detail(seen, told, 1.0)
        assert np.isfinite(drawn).all() and np.abs(drawn).max() <= 1
