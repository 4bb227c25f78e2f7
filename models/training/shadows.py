"""Hard light painted over charts: shadows that something throws on a face, and what oily skin mirrors of a lamp.

Captures have the shadows that a head throws on itself. Photos have more: those of hair, brims, glasses, hands, leaves
and blinds. They lie on the shape of the head, and only where the lamp reaches it: so what throws them is drawn on a
plane before the lamp and looked up along its rays. Highlights follow the normals (Blinn 1977). Both change the texture
alone: the albedo stays.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

from models.colour import linear, srgb
from models.training.degrade import blur, smooth_field
from models.training.tasks import choice, uniform
from service.runtime.network_registry import GEOMETRY

SHADOWED, SHINING = 0.35, 0.45
"""Shares of the charts with a painted shadow, and with painted highlights."""

DEPTH = (0.25, 2.4)
"""Range of -log of the light that is left in a shadow: the rest comes from elsewhere."""

TINT = 0.1
"""Standard deviation of the same by channel: other lamps have other hues."""

PLANE, REACH = 128, 1.4
"""Texels along the plane of what throws shadows, and its half side in units of 128 mm."""

SHARP = (0.0, 2.5)
"""Standard deviation of the penumbra, texels of that plane (2.8 mm)."""

EXPONENT, MIRRORED, BRIGHTEST = (1.5, 150.0), (0.008, 0.06), 0.6
"""Of highlights: Blinn's exponent, broad sheen of a sky to a bare lamp; share of the light that skin mirrors (its F0 is
0.028, more at a slant), both spread evenly in their logarithm; and the largest radiance, where white in the photo is 1.
A sheen is little beside fair skin and half of what dark skin shows."""

_NORMAL = [GEOMETRY.index(f"normal_object_{axis}") for axis in "xyz"]
_POSITION = [GEOMETRY.index(f"position_{axis}") for axis in "xyz"]


def hard_light(texture: Tensor, geometry: Tensor, generator: torch.Generator) -> Tensor:
    """(N, 3, h, w) sRGB-coded textures in [0, 1] with shadows and highlights on some.

    Args:
        texture: (N, 3, h, w) sRGB-coded in [0, 1].
        geometry: (N, 11, h, w) channels ``GEOMETRY``.
        generator: what and where.
    """
    normal = functional.normalize(geometry[:, _NORMAL].float(), dim=1)
    towards = directions(len(texture), generator)
    left = torch.exp(-shadow(geometry[:, _POSITION].float(), normal, towards, generator))
    return srgb((linear(texture) * left + highlight(normal, towards, generator)).clamp(0.0, 1.0))


def directions(n: int, generator: torch.Generator) -> Tensor:
    """(N, 3) unit vectors towards lamps before, beside and above a face."""
    yaw = uniform(generator, -1.3, 1.3, n)
    pitch = uniform(generator, -0.2, 1.3, n)
    return torch.stack([yaw.sin() * pitch.cos(), pitch.sin(), yaw.cos() * pitch.cos()], 1)


def shadow(position: Tensor, normal: Tensor, towards: Tensor, generator: torch.Generator) -> Tensor:
    """(N, 3, h, w) -log of what is left of the light; 0 on charts without one, and where the lamp does not reach."""
    n = len(position)
    right = functional.normalize(torch.linalg.cross(torch.tensor([[0.0, 1.0, 0.0]]).expand(n, 3), towards), dim=1)
    up = torch.linalg.cross(towards, right)
    axes = torch.stack([right, -up], 1)
    grid = torch.einsum("nchw,nac->nhwa", position, axes) / REACH
    here = (torch.rand(n, generator=generator) < SHADOWED).nonzero().flatten()
    before = occluders(len(here), generator)
    thrown = torch.zeros(n, 1, *position.shape[2:])
    thrown[here] = functional.grid_sample(before, grid[here], padding_mode="border", align_corners=False)
    reached = (torch.einsum("nchw,nc->nhw", normal, towards)[:, None] / 0.15).clamp(0.0, 1.0)
    amount = uniform(generator, *DEPTH, n, 1, 1, 1) * torch.exp(TINT * torch.randn(n, 3, 1, 1, generator=generator))
    return amount * thrown * reached


def occluders(n: int, generator: torch.Generator) -> Tensor:
    """(N, 1, PLANE, PLANE) in [0, 1]: 1 where something stands before the lamp: an edge, bars, blinds, or leaves."""
    axis = torch.linspace(-1.0, 1.0, PLANE)
    y, x = torch.meshgrid(axis, axis, indexing="ij")
    result = [torch.zeros(0, 1, PLANE, PLANE)]
    for _ in range(n):
        turn, away = (float(uniform(generator, *span, 1)) for span in ((-math.pi, math.pi), (-0.5, 0.5)))
        along = x * math.cos(turn) + y * math.sin(turn)
        cells = (4, 8, 16)[choice(generator, 3)]
        bent = along + 0.12 * smooth_field((1, 1, PLANE, PLANE), cells, generator)[0, 0]
        kind = choice(generator, 4)
        if kind == 0:  # the edge of a wall, a brim, a fringe
            thrown = (bent > away).float()
        elif kind == 1:  # an arm, a rod, a strand
            thrown = ((bent - away).abs() < float(uniform(generator, 0.02, 0.2, 1))).float()
        elif kind == 2:  # blinds
            period, open_ = float(uniform(generator, 0.08, 0.4, 1)), float(uniform(generator, -0.5, 0.5, 1))
            thrown = (torch.sin(along * 2.0 * math.pi / period) > open_).float()
        else:  # leaves
            thrown = (smooth_field((1, 1, PLANE, PLANE), 2 * cells, generator)[0, 0] > away).float()
        soft = float(uniform(generator, *SHARP, 1))
        result.append(blur(thrown[None, None], soft))
    return torch.cat(result)


def highlight(normal: Tensor, towards: Tensor, generator: torch.Generator) -> Tensor:
    """(N, 3, h, w) radiance that skin mirrors of a lamp to a camera before the face; 0 on charts without it."""
    n = len(normal)

    def between(least: float, most: float) -> Tensor:
        return torch.exp(uniform(generator, math.log(least), math.log(most), n, 1, 1, 1))

    half = functional.normalize(towards + torch.tensor([0.0, 0.0, 1.0]), dim=1)
    cosine = torch.einsum("nchw,nc->nhw", normal, half)[:, None].clamp(min=0.0)
    uneven = (1.0 + 0.4 * smooth_field((n, 1, *normal.shape[2:]), 48, generator)).clamp(min=0.0)
    tint = torch.exp(TINT * torch.randn(n, 3, 1, 1, generator=generator))
    here = torch.rand(n, 1, 1, 1, generator=generator) < SHINING
    exponent = between(*EXPONENT)
    strength = (between(*MIRRORED) * (exponent + 8.0) / 8.0).clamp(max=BRIGHTEST)  # its energy stays the same
    return here * strength * cosine**exponent * uneven * tint
