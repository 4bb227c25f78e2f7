"""More skins than captures: one subject's light on another's skin, and skin as other devices have measured it."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from models.colour import linear, srgb
from models.training.albedo import log_light
from models.training.tasks import uniform
from service.colour import LUMA

SWAPPED, ALIKE = 0.5, 0.3
"""Share of training charts that show another subject's skin, and the largest difference of mean log albedo."""

SCALE, SPREAD = 0.65, (0.60, 0.40)
"""Of log(albedo as captured / albedo of the light stage): mean of fair skin, and standard deviation of fair and of dark
skin. The stage's skin is as light as spectrophotometers find it, L* up to 70. Published albedo maps of fair faces lie
at 65 to 75, the same hue being brighter there by a quarter or more, and calibrations differ from each other by as much.
The range is wider than that: in a narrow one the network learns how bright skin is from its hue, and heeds the whites
of the eyes little."""

DARK_SCALE = -0.05
"""The same mean of dark skin. With the mean of fair skin, training showed no skin as dark as there is: the darkest was
half as bright again, and the network made dark faces two to three times too bright."""

DARK, FAIR = math.log(0.06), math.log(0.30)
"""Log luminance of the stage's skin up to which it counts as dark, and from which as fair; between them, between."""

HUE = 0.09
"""Standard deviation of the same by channel, less its mean."""

DARKENED, MELANIN, BY_CHANNEL = 0.2, (0.2, 2.0), (0.88, 1.0, 1.1)
"""Share of the charts whose skin gets more melanin; optical depth of that in green; and by channel, over green."""

BRIGHTEST = 0.95
"""Linear value that all but a hundredth of a chart stays below, whatever the scale."""


def relit(
    texture: Tensor, albedo: Tensor, skin: Tensor, mask: Tensor, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Charts of which some show another subject's skin in the first one's light, where both are about as dark.

    The light of a capture includes reflections at the surface, which count for more on dark skin; hence the bound.

    Args:
        texture: (N, 3, h, w) sRGB-coded in [0, 1].
        albedo: (N, 3, h, w) likewise.
        skin: (N, 3, h, w) likewise, albedo of the others.
        mask: (N, 1, h, w) 1 inside the islands.
        generator: which charts.

    Returns:
        texture and albedo, sRGB-coded in [0, 1].
    """
    apart = log_light(skin, albedo)
    differ = (apart * mask).sum((1, 2, 3)).abs() / (3.0 * mask.sum((1, 2, 3)) + 1.0)
    here = ((differ < ALIKE) & (torch.rand(len(skin), generator=generator) < SWAPPED)).view(-1, 1, 1, 1)
    return torch.where(here, srgb(linear(texture) * torch.exp(apart)), texture), torch.where(here, skin, albedo)


def darkened(texture: Tensor, albedo: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Charts of which some have darker skin under the same light, both (N, 3, h, w) sRGB-coded in [0, 1].

    What the surface mirrors becomes darker with it, which is wrong; ``models.training.shadows`` paints more of that
    than is lost. Skin that is dark already stays as it is.
    """
    n = len(albedo)
    depth = uniform(generator, *MELANIN, n, 1, 1, 1) * (torch.rand(n, 1, 1, 1, generator=generator) < DARKENED)
    hue = torch.tensor(BY_CHANNEL) * torch.exp(0.06 * torch.randn(n, 3, generator=generator))
    left = torch.exp(-fairness(albedo) * depth * hue[..., None, None])
    return srgb(linear(texture) * left), srgb(linear(albedo) * left)


def fairness(albedo: Tensor) -> Tensor:
    """(N, 1, 1, 1) in [0, 1] of sRGB-coded skin (N, 3, h, w): 0 dark, 1 fair, by the median of its luminance."""
    luminance = torch.einsum("nchw,c->nhw", linear(albedo), torch.as_tensor(LUMA).to(albedo))
    usual = luminance.flatten(1).median(1).values.clamp(min=1e-4).log()
    return ((usual - DARK) / (FAIR - DARK)).clamp(0.0, 1.0).view(-1, 1, 1, 1)


def recalibrated(texture: Tensor, albedo: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Charts as another device would have measured the skin: as brightly exposed, with the light that this leaves.

    Args:
        texture: (N, 3, h, w) sRGB-coded in [0, 1].
        albedo: (N, 3, h, w) likewise.
        generator: scale and hue of each chart.

    Returns:
        both, sRGB-coded in [0, 1].
    """
    n = len(albedo)
    fair = fairness(albedo)
    mean, spread = DARK_SCALE + fair * (SCALE - DARK_SCALE), SPREAD[1] + fair * (SPREAD[0] - SPREAD[1])
    scale = mean + spread * torch.randn(n, 1, 1, 1, generator=generator)
    hue = HUE * torch.randn(n, 3, 1, 1, generator=generator)
    hue = torch.exp(hue - hue.mean(1, keepdim=True))
    skin = linear(albedo) * hue
    most = torch.quantile(skin.amax(1).flatten(1), 0.99, dim=1).clamp(min=1e-3).view(n, 1, 1, 1)
    skin = skin * torch.minimum(torch.exp(scale), (BRIGHTEST / most).clamp(min=1.0))
    return srgb((linear(texture) * hue).clamp(0.0, 1.0)), srgb(skin.clamp(0.0, 1.0))
