"""What delta's context is told of the light by the eyes."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from models.colour import linear, srgb  # noqa: E402
from models.lightstage.split import HELD_OUT, TRAIN  # noqa: E402
from models.training.capture import WHOLE  # noqa: E402
from models.training.context import MISFIT, MISFITTED, MISPLACED, ContextTask, best_gain, misfitted, misplaced  # noqa: E402
from models.training.eyes import (  # noqa: E402
    ERROR,
    EXPOSED,
    FAITH,
    FLAT,
    FLATTER,
    LESS,
    exposed,
    eye_light,
    face_zone,
    lid_zones,
)
from service.face.features.eye_colours import BRIGHTEST_TOLD  # noqa: E402

pytestmark = pytest.mark.train


def test_lids_lie_on_either_side() -> None:
    """Zones of the two eyes are each other's mirror images and do not meet."""
    left, right = lid_zones()
    assert float(left.sum()) == pytest.approx(1.0, abs=1e-4) and not ((left > 0) & (right > 0)).any()
    assert torch.allclose(left.flip(-1), right, atol=2e-3)


def test_eyes_show_the_light_that_reaches_them() -> None:
    """That of the lids and what brows and lids leave of it, on average; and nothing where they are not seen."""
    zones = lid_zones()
    light = torch.full((800, 3, *zones.shape[1:]), -0.7)
    whites = torch.full((800, 2, 3), -0.2)
    whites[400:] -= 1.0
    left = 1.0 - sum(FLATTER) / 2.0
    generator = torch.Generator().manual_seed(1)
    seen = eye_light(light, zones, whites, torch.ones(800), generator)
    usual, deep = seen[:400, 1], seen[400:, 1]
    spread = (usual.quantile(0.84) - usual.quantile(0.16)) / 2
    usually = -0.7 + LESS + FAITH * (FLAT + left * (-0.2 - FLAT))
    assert float(usual.median()) == pytest.approx(usually, abs=0.12), "mistakes are the exception"
    assert float(usual.median() - deep.median()) == pytest.approx(FAITH * left, abs=0.12)
    assert float(spread) == pytest.approx(ERROR, rel=0.5), "mistakes widen it"
    assert float((seen[:, 0] - seen[:, 1]).std()) < 0.12, "the eyes tell the tint better than the strength"
    assert not eye_light(light[:4], zones, whites[:4], torch.zeros(4), generator).any()


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


def test_eyes_tell_no_more_light_than_a_sensor_can_show() -> None:
    """The photo of a dark face is bright, and its whites are overexposed: they tell the least that does that."""
    zones = lid_zones()
    light = torch.full((200, 3, *zones.shape[1:]), 3.0)
    light[:, 0] += 0.3
    seen = eye_light(light, zones, torch.zeros(200, 2, 3), torch.ones(200), torch.Generator().manual_seed(6))
    assert float(seen[:, :3].mean(1).max()) <= math.log(BRIGHTEST_TOLD) + 1e-5
    assert float(seen[:, :3].mean(1).median()) == pytest.approx(math.log(BRIGHTEST_TOLD), abs=1e-5)
    assert float((seen[:, 0] - seen[:, 1]).median()) == pytest.approx(0.3, abs=0.05)


def test_photos_are_exposed_for_the_light_and_not_for_the_skin() -> None:
    """Dark and fair skin get the same light, so that brightness tells them apart; what stays is the same."""
    zone = face_zone()
    assert float(zone.sum()) == pytest.approx(1.0, abs=1e-4)
    skin = torch.tensor([0.03, 0.3]).repeat(300).view(-1, 1, 1, 1).expand(-1, 3, *zone.shape[1:])
    albedo, texture = srgb(skin), srgb(skin * 0.2)
    here = (torch.arange(600) < 400).float()
    found = exposed(texture, albedo, zone, here, torch.Generator().manual_seed(7))
    assert torch.equal(found[400:], texture[400:])
    light = (linear(found[:400]) / skin[:400]).mean((1, 2, 3)).log()
    for tone in (light[::2], light[1::2]):
        assert float(tone.mean()) == pytest.approx(EXPOSED[0], abs=0.12)
    assert float(light[::2].std()) == pytest.approx(EXPOSED[1], rel=0.2)
    black = exposed(torch.zeros(2, 3, *zone.shape[1:]), albedo[:2], zone, torch.ones(2), torch.Generator())
    assert black.isfinite().all(), "no light at all: a gain without bound"


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


def test_misplaced_planes_stay_together_and_move_by_little() -> None:
    """Texture and albedo moved apart would be light that nobody cast; moved too far, brows would be on the lids."""
    ramp = torch.arange(96.0).expand(40, 1, 64, 96)
    both = misplaced([ramp, 2.0 * ramp], torch.Generator().manual_seed(5))
    assert torch.allclose(both[1], 2.0 * both[0], atol=1e-3)
    moved = (both[0] - ramp)[:, 0, 8:-8, 8:-8]
    each = moved.square().mean((1, 2)).sqrt()
    assert torch.isfinite(moved).all() and 0.2 * MISPLACED < float(each.mean()) < MISPLACED
    assert float(moved.diff(dim=2).abs().amax()) < 1.0, "smooth: nothing is torn or folded"
