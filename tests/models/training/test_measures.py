"""What is left of the light in an albedo, and how far its colours look off."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("skimage")

from torch import Tensor  # noqa: E402

from models.colour import linear, srgb  # noqa: E402
from models.training.measures import colour_difference, correlation, light_left  # noqa: E402

pytestmark = pytest.mark.train

ONES = torch.ones(1, 1, 32, 48)


def skin() -> tuple[Tensor, Tensor]:
    """Coded albedo with blotches, and the same in light from the side."""
    rng = torch.Generator().manual_seed(0)
    albedo = torch.tensor([0.45, 0.27, 0.2]).view(1, 3, 1, 1) * torch.exp(
        0.1 * torch.randn(1, 1, 32, 48, generator=rng)
    )
    return srgb(albedo), srgb(albedo * torch.exp(torch.linspace(-1.5, 0.3, 48)))


def test_light_left_is_nothing_of_a_right_albedo_and_all_of_the_texture() -> None:
    """By one factor everywhere it may be off: that is known from the exposure at best."""
    albedo, texture = skin()
    assert light_left(texture, albedo, texture, ONES) == pytest.approx(1.0, abs=1e-3)
    assert light_left(srgb(linear(albedo) * 0.8), albedo, texture, ONES) < 0.02
    noise = 0.2 * torch.randn(1, 1, 32, 48, generator=torch.Generator().manual_seed(1))
    assert light_left(srgb(linear(albedo) * torch.exp(noise)), albedo, texture, ONES) < 0.1


def test_nowhere_and_constant_maps_give_no_nan() -> None:
    """A correlation divides by both deviations."""
    albedo, texture = skin()
    assert light_left(albedo, albedo, albedo, ONES) == 0.0
    assert light_left(texture, albedo, texture, 0 * ONES) == 0.0
    assert correlation(np.zeros(1), np.zeros(1)) == 0.0
    assert np.isnan(colour_difference(albedo, albedo, 0 * ONES))


def test_colour_difference_is_that_of_cie() -> None:
    """A pair of Sharma, Wu and Dalal's test data, as near as sRGB can show: L* 50 beside 56, neutral."""
    from skimage.color import lab2rgb

    grey, lighter = (
        torch.tensor(lab2rgb(np.array([[[value, 0.0, 0.0]]]))).permute(2, 0, 1)[None].expand(1, 3, 32, 48).float()
        for value in (50.0, 56.0)
    )
    # CIEDE2000 of neutrals: |dL| / S_L with S_L of the mean lightness 53.
    expected = 6.0 / (1 + 0.015 * 3.0**2 / np.sqrt(20 + 3.0**2))
    assert colour_difference(grey, lighter, ONES) == pytest.approx(expected, abs=0.02)
