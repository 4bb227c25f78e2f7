"""What delta's context is trained on: the light of the eyes, and one subject's light on another's skin."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from models.training.albedo import log_light  # noqa: E402
from models.training.context import ALIKE, SHADE, eye_light, lid_zones, relit  # noqa: E402
from models.training.store import Arrays  # noqa: E402
from models.training.tasks import byte  # noqa: E402

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


def item(albedo: float, texture: float) -> Arrays:
    """A capture of one colour."""
    return {
        "albedo": np.full((3, 8, 12), round(albedo * 255), np.uint8),
        "texture": np.full((2, 3, 8, 12), round(texture * 255), np.uint8),
        "geometry": np.ones((11, 8, 12), np.float16),
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
    kept = relit(one, 1, far)
    assert (kept["albedo"] == one["albedo"]).all() and ALIKE < 1.0
