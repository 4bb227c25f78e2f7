"""What delta's context is told of the light by the eyes."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")

from models.training.context import MISFIT, MISFITTED, SHADE, best_gain, eye_light, lid_zones, misfitted  # noqa: E402

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


def test_misfitted_heads_are_between_two_and_mostly_their_own() -> None:
    geometry = torch.arange(8.0).view(8, 1, 1, 1).expand(8, 11, 4, 6).contiguous()
    generator = torch.Generator().manual_seed(2)
    told = torch.stack([misfitted(geometry, generator) for _ in range(200)])
    part = (told - geometry) / (geometry.roll(1, 0) - geometry)
    assert part.min() >= 0.0 and 0.8 * MISFIT < part.max() <= MISFIT
    assert float((part[:, :, 0, 0, 0] > 0).float().mean()) == pytest.approx(MISFITTED, abs=0.05)
    same = geometry[:1].expand(4, -1, -1, -1)
    assert torch.equal(misfitted(same, generator), same), "position and mask are everybody's"


def test_a_gain_costs_once_and_shade_twice() -> None:
    """The best gain is taken off by chart and channel, on seen skin only; the shape of the light keeps its own part."""
    lit = torch.zeros(2, 1, 8, 12)
    lit[:, :, :, :6] = 1.0
    albedo = torch.full((2, 3, 8, 12), 0.6)
    batch = {"clean": albedo, "albedo": albedo, "lit": lit}
    gain = torch.tensor([[0.3, -0.1, 0.2], [-0.4, 0.1, 0.0]]).view(2, 3, 1, 1)
    light = gain.expand(2, 3, 8, 12) + torch.where(lit > 0, 0.0, 5.0)
    assert torch.allclose(best_gain(light, batch), gain, atol=1e-5)
    assert torch.isfinite(best_gain(light, batch | {"lit": torch.zeros_like(lit)})).all(), "divided by no skin"
