"""One task per network: what a batch is, what the loss is, and what is measured on held-out subjects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from models.training.store import Arrays, Patches
from service.reflectance.subject import GEOMETRY_SIZE
from service.runtime.network_registry import GEOMETRY

Batch = dict[str, Tensor]

FLIPPED = torch.tensor([-1.0 if name.endswith("_x") else 1.0 for name in GEOMETRY])
"""Sign of each geometry channel in a mirrored chart."""


class Task(Protocol):
    """What the training loop needs to know of a network."""

    def refresh(self) -> None:
        """Read captures that came since the last time."""

    def batch(self, size: int, generator: torch.Generator) -> Batch:
        """Random training batch."""

    def held_out(self) -> list[Batch]:
        """Fixed batches of subjects that training never sees."""

    def seeds(self) -> list[int]:
        """The subject of each item of the held-out batches, in order."""

    def predict(self, network: nn.Module, batch: Batch) -> Tensor:
        """The network's result."""

    def loss(self, result: Tensor, batch: Batch) -> Tensor:
        """What is minimised."""

    def measure(self, result: Tensor, batch: Batch) -> dict[str, float]:
        """Named numbers; ``score`` is the one to choose by, larger is better."""

    def sheet(self, result: Tensor, batch: Batch) -> Tensor:
        """(3, h, w) picture in [0, 1] of a result beside the truth."""


def uniform(generator: torch.Generator, low: float, high: float, *shape: int) -> Tensor:
    """Random numbers of a shape."""
    return low + (high - low) * torch.rand(*shape, generator=generator)


def one(generator: torch.Generator, low: float, high: float) -> float:
    """A random number."""
    return float(uniform(generator, low, high, 1))


def choice(generator: torch.Generator, count: int) -> int:
    """A random index."""
    return int(torch.randint(count, (1,), generator=generator))


def byte(values: np.ndarray) -> Tensor:
    """uint8 -> float32 in [0, 1]."""
    return torch.as_tensor(np.ascontiguousarray(values)).float() / 255.0


@dataclass(frozen=True)
class Crop:
    """A random part of a patch, mirrored or not."""

    row: int
    column: int
    side: int
    flip: bool

    @classmethod
    def random(cls, side: int, whole: int, generator: torch.Generator, multiple: int = 8) -> Crop:
        """Corners at multiples, so that geometry cells are met."""
        steps = (whole - side) // multiple + 1
        row, column = (multiple * choice(generator, steps) for _ in range(2))
        return cls(row, column, side, bool(torch.rand(1, generator=generator) < 0.5))

    def cut(self, values: np.ndarray) -> np.ndarray:
        """(C, h, w) -> (C, side, side)."""
        part = values[:, self.row : self.row + self.side, self.column : self.column + self.side]
        return part[..., ::-1] if self.flip else part


def enlarged(cells: np.ndarray, scale: int, crop: Crop) -> Tensor:
    """Geometry cells with a margin of one -> (C, side, side) under a crop by bilinear enlargement, centres aligned."""
    row, column, count = crop.row // scale, crop.column // scale, crop.side // scale + 2
    near = np.asarray(cells[:, row : row + count, column : column + count], np.float32)
    big = functional.interpolate(
        torch.from_numpy(near)[None], scale_factor=float(scale), mode="bilinear", align_corners=False
    )[0]
    part = big[:, scale : scale + crop.side, scale : scale + crop.side]
    return part.flip(-1) * FLIPPED.view(-1, 1, 1) if crop.flip else part


def crop_of(item: Arrays, crop: Crop) -> Batch:
    """Maps of a patch under a crop, as float32: colours in [0, 1], normals unit; texels along its whole chart.

    ``place`` is (4,): left, top, right and bottom end as shares of the chart; left and right swapped where mirrored.
    """
    chart_width = int(item["window"][4])
    width = torch.full((1, 1, 1), float(chart_width))
    result = {"geometry": enlarged(item["geometry"], chart_width // GEOMETRY_SIZE[0], crop), "chart_width": width}
    left, top = (int(item["window"][i]) + n for i, n in enumerate((crop.column, crop.row)))
    ends = (left + crop.side, left) if crop.flip else (left, left + crop.side)
    size = torch.tensor([chart_width, chart_width * GEOMETRY_SIZE[1] / GEOMETRY_SIZE[0]] * 2)
    result["place"] = torch.tensor([ends[0], top, ends[1], top + crop.side]) / size
    for name in ("albedo", "specular", "mask", "hair", "texture"):
        if name in item:
            result[name] = byte(crop.cut(item[name]))
    for name in ("specular_normal", "diffuse_normal"):
        if name in item:
            xy = torch.from_numpy(np.asarray(crop.cut(item[name]), np.float32) / np.float32(32767.0))
            if crop.flip:
                xy = xy * torch.tensor([-1.0, 1.0]).view(2, 1, 1)
            z = (1.0 - xy.square().sum(0, keepdim=True)).clamp(min=1e-4).sqrt()
            result[name] = torch.cat([xy, z])
    return result


def stack(crops: list[Batch]) -> Batch:
    """Crops as one batch."""
    return {name: torch.stack([crop[name] for crop in crops]) for name in crops[0]}


def patch_batch(patches: Patches, size: int, side: int, generator: torch.Generator) -> Batch:
    """Random crops of random patches."""
    items = [patches.items[choice(generator, len(patches.items))] for _ in range(size)]
    return stack([crop_of(i, Crop.random(side, int(i["window"][2]), generator)) for i in items])


MOST_HELD_OUT = 200
"""Held-out patches or charts at most; with 24 of them a skin tone had three."""


def fixed_items(patches: Patches) -> list[Arrays]:
    """Patches evenly taken from all."""
    return patches.items[:: max(len(patches.items) // MOST_HELD_OUT, 1)][:MOST_HELD_OUT]


def fixed_batches(patches: Patches, side: int) -> list[Batch]:
    """Middles of the fixed patches."""
    items = fixed_items(patches)
    middle = (int(items[0]["window"][2]) - side) // 2 // 8 * 8
    crops = [crop_of(item, Crop(middle, middle, side, False)) for item in items]
    return [stack(crops[i : i + 4]) for i in range(0, len(crops), 4)]


def channels(batch: Batch, names: tuple[str, ...]) -> Tensor:
    """Geometry channels by name."""
    return batch["geometry"][:, [GEOMETRY.index(name) for name in names]]


def psnr(a: Tensor, b: Tensor, mask: Tensor) -> float:
    """Peak signal-to-noise ratio in dB of values in [0, 1] over a mask, at most 99."""
    count = mask.sum() * a.shape[1] + 1e-6
    error = float(((a - b).square() * mask).sum() / count)
    return min(-10.0 * float(np.log10(max(error, 1e-12))), 99.0)
