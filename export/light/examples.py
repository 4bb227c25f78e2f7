"""Inputs on which exported light has to agree with torch, degenerate ones among them; the same numbers every time."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from service.light.environment import prefiltered

Inputs = dict[str, Tensor]
Size = tuple[int, int]


def _uniform(size: Size, *shape: int, low: float = 0.0, high: float = 1.0, salt: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(1000 * size[0] + size[1] + 77_777 * salt)
    return torch.rand(*shape, generator=generator) * (high - low) + low


def _directions(size: Size, salt: int) -> Tensor:
    """(3, h, w) unit vectors all around."""
    raw = _uniform(size, 3, *size, low=-1.0, salt=salt)
    return raw / raw.square().sum(0).sqrt().clamp(min=1e-3)


def _normals(size: Size) -> Tensor:
    """Unit vectors; one of them none, one grazing the view of ``_views``."""
    normals = _directions(size, 3)
    normals[:, 0, 0] = 0.0
    normals[:, 0, 1] = torch.tensor([1.0, 0.0, 0.0])
    return normals


def _views(size: Size) -> Tensor:
    views = _directions(size, 4)
    views[:, 0, 1] = torch.tensor([0.0, 0.0, 1.0])
    views[:, 0, 2] = _normals(size)[:, 0, 2]
    return views


def _lamp(size: Size) -> Inputs:
    at = _uniform(size, 3, low=-1.0, salt=5)
    return {"at": at, "intensity": _uniform(size, 3, high=3.0, salt=6), "radius": torch.tensor(0.05 * (size[0] % 2))}


def _positions(size: Size) -> Tensor:
    """mm; one of them right at the lamp."""
    positions = _uniform(size, 3, *size, low=-120.0, high=120.0, salt=7)
    positions[:, 1, 1] = _lamp(size)["at"] * 1000.0
    return positions


def _plane(size: Size, salt: int, low: float = 0.0, high: float = 1.0) -> Tensor:
    return _uniform(size, *size, low=low, high=high, salt=salt)


def _ball(size: Size) -> tuple[Tensor, Tensor]:
    """Points (3, M) of a ball of 80 mm, and as many (6, N) of its surface as a map has texels."""
    raw = _uniform(size, 4000, 3, low=-1.0, salt=2)
    occluders = 80.0 * raw / raw.norm(dim=1, keepdim=True)
    normal = _directions(size, 8).reshape(3, -1)
    return occluders.T.contiguous(), torch.cat([80.0 * normal, normal])


def _depth(size: Size, name: str, towards: Tensor) -> Inputs:
    occluders, points = _ball(size)
    blank = torch.full((256, 256), -1e30)
    return {
        "occluders": occluders, "points": points, name: towards, "spacing_mm": torch.tensor(2.5), "blank": blank,
    }  # fmt: skip


def _shining(size: Size) -> Inputs:
    return {"specular": _plane(size, 11, high=1.2), "alpha": _plane(size, 12, high=1.1)}


def _sky(size: Size) -> Tensor:
    sky = np.random.default_rng(size[1]).uniform(0.0, 2.0, (64, 128, 3))
    return torch.from_numpy(prefiltered(sky))


def _scattering(size: Size) -> Inputs:
    """With a hole in the skin, and skin so dense that the profile reaches its widest."""
    mask = torch.ones(size)
    mask[size[0] // 2 :, : size[1] // 3] = 0.0
    density = _plane(size, 14, 0.5, 4.0)
    density[-1] = 12.0
    return {
        "albedo": _uniform(size, 3, *size, salt=15), "arriving": _uniform(size, 3, *size, high=3.0, salt=16),
        "texels_per_mm": density, "mask": mask,
    }  # fmt: skip


EXAMPLES: dict[str, Callable[[Size], Inputs]] = {
    "lit_from_direction": lambda size: _depth(
        size, "direction", torch.tensor([math.sin(size[1]), 0.0, math.cos(size[1])])
    ),
    "lit_from_point": lambda size: _depth(size, "light_mm", torch.tensor([60.0, 20.0, 300.0 if size[0] % 2 else 0.0])),
    "irradiance": lambda size: {
        "position": _positions(size), "normal": _normals(size), "shade": _plane(size, 9), **_lamp(size),
    },
    "scattering": _scattering,
    "reflection": lambda size: {
        "levels": _sky(size), "view": _views(size), "normal": _normals(size), "part": _plane(size, 18),
        "alpha": _plane(size, 12, high=1.1), "openness": _plane(size, 19),
    },
    "kept": lambda size: {"view": _views(size), "normal": _normals(size), **_shining(size)},
    "highlight": lambda size: {
        "position": _positions(size), "view": _views(size), "normal": _normals(size), "shade": _plane(size, 9),
        **_shining(size), **_lamp(size),
    },
}  # fmt: skip
"""Named inputs of each graph for a size (rows, columns)."""
