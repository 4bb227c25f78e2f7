"""Exposure and style of photos, given to charts of the light stage."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")

from torch import Tensor  # noqa: E402

from models.colour import linear, srgb  # noqa: E402
from models.training.albedo import log_light  # noqa: E402
from models.training.exposure import AS_IT_IS, EXPOSED, MIDDLE, as_photographed, other_skin, styled  # noqa: E402

pytestmark = pytest.mark.train

ZONES = torch.full((2, 8, 12), 1 / 96)


def charts(albedo: float, light: float, count: int = 600) -> tuple[Tensor, Tensor]:
    """Coded texture and albedo of one colour, from linear values."""
    skin = torch.full((count, 3, 8, 12), albedo)
    return srgb((skin * light).clamp(max=1.0)), srgb(skin)


def test_light_on_the_lids_is_that_of_photos() -> None:
    """Whatever the exposure of the capture was."""
    texture, albedo = charts(torch.tensor(MIDDLE).exp().item(), 2.5)
    found = as_photographed(texture, albedo, ZONES, torch.Generator().manual_seed(1))
    logs = log_light(found, albedo).mean((1, 2, 3))
    assert float(logs.median()) == pytest.approx(EXPOSED[0], abs=0.12)
    kept = (found - texture).abs().amax((1, 2, 3)) < 1e-4
    assert float(kept.float().mean()) == pytest.approx(AS_IT_IS, abs=0.06)


def test_dark_skin_is_darker_in_photos() -> None:
    """As bright in the capture, it would be taken for fair skin in less light."""
    generator = torch.Generator().manual_seed(2)
    dark = as_photographed(*charts(0.05, 8.0), ZONES, generator)
    fair = as_photographed(*charts(0.45, 0.9), ZONES, generator)
    assert float(linear(dark).median()) < 0.4 * float(linear(fair).median())


def test_black_and_overexposed_charts_stay_finite() -> None:
    """No light or no albedo: the logarithms have a floor, or NaN would end the training."""
    for albedo, light in ((0.0, 1.0), (0.4, 0.0), (0.0, 0.0), (1.0, 50.0)):
        for made in (as_photographed(*charts(albedo, light, 20), ZONES, torch.Generator().manual_seed(3)),):
            assert made.isfinite().all() and made.min() >= 0.0 and made.max() <= 1.0


def test_a_style_leaves_black_white_and_grey_neutral() -> None:
    """It changes contrast and saturation, not the white balance; and some charts stay as they are."""
    levels = torch.linspace(0, 1, 12).expand(400, 3, 8, 12)
    made = styled(levels, torch.Generator().manual_seed(4))
    assert torch.allclose(made[..., 0], levels[..., 0], atol=1e-6)
    assert torch.allclose(made[..., -1], levels[..., -1], atol=1e-5)
    assert float((made - made.mean(1, keepdim=True)).abs().max()) < 1e-5
    untouched = (made - levels).abs().amax((1, 2, 3)) < 1e-6
    assert 0.3 < float(untouched.float().mean()) < 0.7
    assert (made.diff(dim=-1) > 0).all(), "brighter stays brighter"


def test_a_style_changes_saturation_both_ways() -> None:
    """Fair skin in a colourful picture must not be learnt as brown."""
    skin = torch.tensor([0.75, 0.6, 0.5]).view(1, 3, 1, 1).expand(400, 3, 4, 4)
    made = styled(skin, torch.Generator().manual_seed(5))
    spread = made.amax(1) - made.amin(1)
    assert float(spread.min()) < 0.23 < 0.29 < float(spread.max())


def test_other_skin_keeps_the_light() -> None:
    """Texture and albedo change by the same factor, so that the light to be found stays; nothing gets beyond white."""
    generator = torch.Generator().manual_seed(6)
    texture, albedo = charts(0.3, 0.8, 200)
    lit, skin = other_skin(texture, albedo, generator)
    assert torch.allclose(log_light(lit, skin), log_light(texture, albedo), atol=1e-3)
    assert float((skin - albedo).abs().amax((1, 2, 3)).median()) > 0.03
    white, _ = other_skin(*charts(1.0, 1.0, 50), generator)
    assert white.max() <= 1.0 and all(each.isfinite().all() for each in other_skin(*charts(0.0, 1.0, 5), generator))
