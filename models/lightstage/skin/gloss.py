"""Specular albedo and roughness."""

from __future__ import annotations

import torch
from torch import Tensor

from models.lightstage.skin.drawn import Drawn
from models.lightstage.skin.relief import fade
from models.lightstage.skin.stack import GaussianStack
from models.lightstage.skin.subject import Subject

LIP_GLOSS = 0.80
LIPSTICK_GLOSS = 0.95
"""Waxes and oils have an index of 1.45 to 1.5, which is an F0 of 0.034 to 0.04."""
HAIR_GLOSS = 0.38
"""Factor where hair covers the skin."""
_FLOOR = 0.35
"""Even the deepest pore keeps this share."""


def specular_albedo(subject: Subject, drawn: Drawn, cavity: GaussianStack, ppm: Tensor, finest: float) -> Tensor:
    """(h, w) s in [0, 1], F0 = 0.04 s: level of the region, darker where the relief hides the surface.

    Occlusion is exp of minus the depth below the mean height within 0.25 mm, and of that below the one within 0.8 mm
    (method 1.4); the finer of both is weak (``Gloss``).
    """
    near, wide = (cavity.at(ppm, [(sigma, 1.0)], finest)[0] for sigma in (0.25, 0.8))
    fine, coarse = (near - drawn.height).clamp(min=0.0), (wide - near).clamp(min=0.0)
    g = subject.gloss
    open_sky = _FLOOR + (1.0 - _FLOOR) * torch.exp(
        -1.5 * (g.occlusion_fine * fine / 0.03 + g.occlusion_coarse * coarse / 0.06)
    )
    lips = (LIP_GLOSS + (LIPSTICK_GLOSS - LIP_GLOSS) * subject.make_up.lipstick) * g.scale
    level = torch.lerp(drawn.base["gloss"], torch.full_like(ppm, lips), drawn.lips)
    level = level * (1.0 + 0.05 * drawn.mottle[3])
    hair = torch.maximum(drawn.hair.cover, 0.85 * scalp_cover(subject, drawn))
    level = level * open_sky * (1.0 - (1.0 - HAIR_GLOSS) * hair.clamp(0.0, 1.0))
    return (level * (1.0 - 0.8 * drawn.base["dark"].clamp(0.0, 1.0))).clamp(0.0, 1.0)


def scalp_cover(subject: Subject, drawn: Drawn) -> Tensor:
    """(h, w) share of the scalp's hair, without its streaks."""
    return ((2.0 * drawn.base["scalp"] * subject.hair.scalp_cover - 0.75) / 0.5).clamp(0.0, 1.0)


def roughness(subject: Subject, drawn: Drawn) -> Tensor:
    """(3, h, w): GGX alpha of both lobes and the share of the narrow one.

    Relief that is too fine for the texels widens the lobes by its slope variance, alpha^2 += 2 sigma^2 (Toksvig, LEAN),
    so copies at lower resolution shine as the full map does from afar.
    """
    s, g = subject.surface, subject.gloss
    factor = drawn.base["roughness"] * (1.0 - 0.25 * drawn.lips)
    lost = (1.0 - fade(drawn.texel_mm, 0.5 * s.secondary_spacing)) * (
        1.8 * s.secondary_depth / s.secondary_spacing
    ) ** 2
    lost = (
        lost + (1.0 - fade(drawn.texel_mm, 0.5 * s.primary_spacing)) * (2.2 * s.primary_depth / s.primary_spacing) ** 2
    )
    lost = lost + (1.0 - fade(drawn.texel_mm, 0.22)) * (6.3 * s.grain_rms / 0.22) ** 2
    narrow = ((g.alpha_narrow * factor) ** 2 + 2.0 * lost * drawn.base["relief"].clamp(min=0.0) ** 2).sqrt()
    broad = ((g.alpha_broad * factor) ** 2 + 2.0 * lost * drawn.base["relief"].clamp(min=0.0) ** 2).sqrt()
    mix = torch.full_like(narrow, g.mix)
    return torch.stack([narrow.clamp(0.05, 1.0), broad.clamp(0.05, 1.0), mix])
