"""What delta's context is told of the light by the eyes."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")

from models.training.context import SHADE, eye_light, lid_zones  # noqa: E402

pytestmark = pytest.mark.train


def test_lids_lie_on_either_side() -> None:
    """Zones of the two eyes are each other's mirror images and do not meet."""
    left, right = lid_zones()
    assert float(left.sum()) == pytest.approx(1.0, abs=1e-4) and not ((left > 0) & (right > 0)).any()
    assert torch.allclose(left.flip(-1), right, atol=2e-3)


def test_eyes_show_the_light_of_the_lids_less_the_shade() -> None:
    """On average; and nothing where they are not seen."""
    zones = lid_zones()
    light = torch.full((500, 3, *zones.shape[1:]), 0.7)
    generator = torch.Generator().manual_seed(1)
    seen = eye_light(light, zones, torch.ones(500), generator)
    middle, spread = seen[:, 1].median(), (seen[:, 1].quantile(0.84) - seen[:, 1].quantile(0.16)) / 2
    assert float(middle) == pytest.approx(0.7 + SHADE[0], abs=0.15), "mistakes are the exception"
    assert float(spread) == pytest.approx(SHADE[1], rel=0.35)
    assert float((seen[:, 0] - seen[:, 1]).std()) < 0.12, "the eyes tell the tint better than the strength"
    assert not eye_light(light[:4], zones, torch.zeros(4), generator).any()
