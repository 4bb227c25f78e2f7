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

AS_IT_IS = 0.1
"""Share of charts that keep the exposure of their capture."""

CHANGE = (-3.5, 0.6)
"""Bounds of the logarithm of the factor: what a capture has lost to overexposure does not come back."""

STYLED = 0.5
"""Share of charts that get a style of their own."""

CONTRAST, COLOURFUL = (-0.4, 0.7), (0.06, 0.15)
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


def as_photographed(texture: Tensor, albedo: Tensor, zones: Tensor, generator: torch.Generator) -> Tensor:
    """sRGB-coded textures (N, 3, h, w) with the exposures of photos.

    Args:
        texture: (N, 3, h, w) sRGB-coded in [0, 1].
        albedo: (N, 3, h, w) sRGB-coded in [0, 1].
        zones: (2, h, w) weights of the lids, each of sum 1 (``models.training.context.lid_zones``).
        generator: exposures.
    """

    def on_lids(logs: Tensor) -> Tensor:
        return torch.einsum("nchw,ehw->n", logs, zones) / (logs.shape[1] * len(zones))

    skin = on_lids(torch.log(linear(albedo).clamp(min=1e-3)))
    wanted = EXPOSED[0] + EXPOSED[1] * torch.randn(len(texture), generator=generator)
    wanted = wanted - FOR_THE_FACE * (skin - MIDDLE)
    change = (wanted - on_lids(log_light(texture, albedo))).clamp(*CHANGE)
    changed = torch.rand(len(texture), generator=generator) >= AS_IT_IS
    factor = torch.where(changed, change, torch.zeros_like(change)).exp()[:, None, None, None]
    return srgb((linear(texture) * factor).clamp(0.0, 1.0))
