"""More skins than captures: the light stays what it was, and what is not skin's stays out of the numbers."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from models.training.albedo import log_light  # noqa: E402
from models.training.skins import (  # noqa: E402
    ALIKE,
    relit,
)
from models.training.store import Arrays  # noqa: E402
from models.training.tasks import byte  # noqa: E402

pytestmark = pytest.mark.train


def item(albedo: float, texture: float) -> Arrays:
    """A capture of one colour."""
    return {
        "albedo": np.full((3, 8, 12), round(albedo * 255), np.uint8),
        "texture": np.full((2, 3, 8, 12), round(texture * 255), np.uint8),
        "geometry": np.ones((11, 8, 12), np.float16),
        "whites": np.arange(12, dtype=np.float32).reshape(2, 2, 3),
    }


def test_the_light_stays_when_the_skin_changes() -> None:
    """log(texture / albedo) before and after; skins too unlike each other are not exchanged."""
    one, other, far = item(0.5, 0.4), item(0.53, 0.9), item(0.9, 0.9)
    mixed = relit(one, 1, other)
    assert (mixed["albedo"] == other["albedo"]).all()
    before, after = (
        log_light(byte(np.asarray(each["texture"])[:1]), byte(np.asarray(each["albedo"]))[None])
        for each in (one, mixed)
    )
    assert torch.allclose(before, after, atol=0.02)
    assert (mixed["whites"] == one["whites"][1:]).all(), "the eyes are in the light that was taken"
    kept = relit(one, 1, far)
    assert (kept["albedo"] == one["albedo"]).all() and ALIKE < 1.0
