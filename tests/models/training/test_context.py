"""What delta's context is told of the light by the eyes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from models.lightstage.split import HELD_OUT, TRAIN  # noqa: E402
from models.training.capture import WHOLE  # noqa: E402
from models.training.context import ContextTask  # noqa: E402
from models.training.eyes import (  # noqa: E402
    FAITH,
    FLAT,
    FLATTER,
    LESS,
    eye_light,
    lid_zones,
)

pytestmark = pytest.mark.train


def test_closed_eyes_tell_nothing_and_the_open_one_is_seen() -> None:
    """NaN of a closed eye must not reach the network, nor may it halve the light of the other."""
    zones = lid_zones()
    light = torch.zeros(600, 3, *zones.shape[1:])
    whites = torch.full((600, 2, 3), -0.2)
    whites[:300, 0], whites[300:] = torch.nan, torch.nan
    seen = eye_light(light, zones, whites, torch.ones(600), torch.Generator().manual_seed(2))
    assert seen.isfinite().all() and (seen[:300, 3] == 1.0).all() and not seen[300:].any()
    left = 1.0 - sum(FLATTER) / 2.0
    assert float(seen[:300, 1].median()) == pytest.approx(LESS + FAITH * (FLAT + left * (-0.2 - FLAT)), abs=0.12)


def test_the_whites_turn_over_with_the_chart(tmp_path: Path) -> None:
    """A chart that is flipped shows its right eye's light on the left."""
    width, height = WHOLE
    rng = np.random.default_rng(3)
    whites = np.zeros((1, 2, 3), np.float32)
    whites[:, 1] = np.nan
    for part in (TRAIN, HELD_OUT):
        (tmp_path / part).mkdir()
        np.savez(
            tmp_path / part / "5_neutral.npz",
            whole_albedo=np.full((3, height, width), 120, np.uint8),
            whole_texture=rng.integers(60, 200, (1, 3, height, width), dtype=np.uint8),
            whole_geometry=np.ones((11, height, width), np.float16),
            whole_whites=whites,
        )
    task = ContextTask(tmp_path)
    task.refresh()
    closed = task.batch(16, torch.Generator().manual_seed(4))["whites"].isnan().all(2)
    assert closed[:, 0].any() and closed[:, 1].any() and (closed.sum(1) == 1).all()
