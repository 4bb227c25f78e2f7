"""How faces look in photos: exposed as people expose, not for the face alone, and in the style of a camera.

The light stage exposes every face alike. Photos do not: a photographer exposes for the scene and only partly for the
face, so that dark skin is darker in the picture, and that is what tells it from fair skin where nothing else does.
``benchmarks.eye_whites --photos DIR`` measures how strong the light on faces is in photos.

Cameras and film also give pictures more contrast and colour than the scene had, or less; fair skin is easily taken for
brown then.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from models.colour import linear, srgb
from models.training.albedo import log_light
from service.colour import LUMA

EXPOSED = (-0.4, 0.5)
"""Mean and standard deviation of log(light on the lids) in photos, where 1 makes a white surface white."""

FOR_THE_FACE = 0.25
"""Share of the difference in the skin's albedo for which the exposure makes up, as cameras that look for faces do."""

MIDDLE = math.log(0.25)
"""Log albedo about which it does."""

AS_IT_IS = 0.04
"""Share of charts that keep the exposure of their capture."""

TINT_LEFT = 0.9
"""Largest share of the light's tint that a camera's white balance leaves."""

WARM = (0.08, 0.07)
"""Mean and standard deviation by which it leaves red over green, and green over blue, in logarithms."""

CHANGE = (-3.5, 0.6)
"""Bounds of the logarithm of the factor: what a capture has lost to overexposure does not come back."""

STYLED = 0.6
"""Share of charts that get a style of their own."""

CONTRAST, COLOURFUL = (-0.4, 0.7), (0.06, 0.2)
"""Range of the share of an S-shaped curve; mean and standard deviation of the logarithm of the factor of saturation."""


def styled(texture: Tensor, generator: torch.Generator) -> Tensor:
    """sRGB-coded textures (N, 3, h, w) in [0, 1] with another contrast and saturation; black and white stay."""
    n = len(texture)
    low, high = CONTRAST
    curve = low + (high - low) * torch.rand(n, 1, 1, 1, generator=generator)
    factor = torch.exp(COLOURFUL[0] + COLOURFUL[1] * torch.randn(n, 1, 1, 1, generator=generator))
    bent = texture + curve * (texture * texture * (3.0 - 2.0 * texture) - texture)
    grey = torch.einsum("nchw,c->nhw", bent, torch.from_numpy(LUMA).to(bent.dtype))[:, None]
    coloured = (grey + factor * (bent - grey)).clamp(0.0, 1.0)
    chosen = torch.rand(n, 1, 1, 1, generator=generator) < STYLED
    return torch.where(chosen, coloured, texture)


SKIN_TINT, SKIN_GAIN = 0.10, (0.1, 0.2)
"""Standard deviation by which the colour channels of skin differ from the light stage's, in logarithms; mean and
deviation of what all three have in common: scanned skin is brighter than the stage's of the same hue."""


def other_skin(texture: Tensor, albedo: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Texture and albedo, sRGB-coded (N, 3, h, w), with skin of colours that the stage's pigments do not mix.

    Else skin that is pinker than they can be would be explained by blue light, and brighter skin by strong light.
    """
    tint = SKIN_TINT * torch.randn(len(texture), 3, 1, 1, generator=generator)
    tint = tint + SKIN_GAIN[0] + SKIN_GAIN[1] * torch.randn(len(texture), 1, 1, 1, generator=generator)
    brightest = linear(albedo).amax((1, 2, 3), keepdim=True).clamp(min=0.1)
    factor = torch.minimum(torch.exp(tint), 1.0 / brightest)
    return srgb((linear(texture) * factor).clamp(0.0, 1.0)), srgb((linear(albedo) * factor).clamp(0.0, 1.0))


def as_photographed(texture: Tensor, albedo: Tensor, zones: Tensor, generator: torch.Generator) -> Tensor:
    """sRGB-coded textures (N, 3, h, w) with the exposures and the white balance of photos.

    Args:
        texture: (N, 3, h, w) sRGB-coded in [0, 1].
        albedo: (N, 3, h, w) sRGB-coded in [0, 1].
        zones: (2, h, w) weights of the lids, each of sum 1 (``models.training.context.lid_zones``).
        generator: exposures.
    """
    n = len(texture)

    def on_lids(logs: Tensor) -> Tensor:
        return torch.einsum("nchw,ehw->nc", logs, zones) / len(zones)

    skin = on_lids(torch.log(linear(albedo).clamp(min=1e-3))).mean(1)
    light = on_lids(log_light(texture, albedo))
    strength = light.mean(1)
    wanted = EXPOSED[0] + EXPOSED[1] * torch.randn(n, generator=generator) - FOR_THE_FACE * (skin - MIDDLE)
    stronger = (wanted - strength).clamp(*CHANGE)[:, None]
    left = TINT_LEFT * torch.rand(n, 1, generator=generator)
    warmer = WARM[0] + WARM[1] * torch.randn(n, 2, generator=generator)
    warmth = torch.stack([warmer[:, 0], torch.zeros(n), -warmer[:, 1]], 1)
    tint = (left - 1.0) * (light - strength[:, None]) + warmth - warmth.mean(1, keepdim=True)
    changed = (torch.rand(n, 1, generator=generator) >= AS_IT_IS).float()
    factor = torch.exp(changed * (stronger + tint))[:, :, None, None]
    return srgb((linear(texture) * factor).clamp(0.0, 1.0))
