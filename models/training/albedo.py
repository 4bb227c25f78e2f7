"""Tasks of delta (light out of the texture) and of its whole-chart context."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from models.colour import linear, srgb
from models.networks.context import DARKEST
from models.networks.stages import Delta
from models.training.degrade import PHOTOS_DETAIL, gain, lost_detail, noisy, smooth_field
from models.training.store import Patches
from models.training.tasks import (
    Batch,
    channels,
    fixed_batches,
    fixed_items,
    patch_batch,
    psnr,
    uniform,
)
from service.runtime.network_registry import GEOMETRY

CONTEXT_CELL = 6144 / 288
"""Texels of the full chart under one of the context's."""


def log_light(texture: Tensor, albedo: Tensor) -> Tensor:
    """log(texture / albedo) of linear values, from sRGB-coded ones."""
    return torch.log(linear(texture).clamp(min=DARKEST)) - torch.log(linear(albedo).clamp(min=DARKEST))


def unlit(texture: Tensor, light: Tensor) -> Tensor:
    """sRGB-coded albedo of a coded texture under a log light."""
    return srgb(linear(texture).clamp(min=DARKEST) * torch.exp(-light.clamp(-4.0, 4.0)))


def context_light(texture: Tensor, albedo: Tensor, cells: int) -> Tensor:
    """(N, 3, cells, cells) log light of coded square patches as coarsely as the context can tell it."""
    return functional.interpolate(log_light(texture, albedo), (cells, cells), mode="area")


def cells_of(side: int) -> int:
    """Cells of the context along a patch of ``side`` texels of the full chart, at least 2."""
    return max(round(side / CONTEXT_CELL), 2)


def albedo_loss(albedo: Tensor, truth: Tensor, mask: Tensor, relative: float = 0.05) -> Tensor:
    """L1 of coded albedo and, ``relative`` as much, of its logarithm (method: method.md 3.4)."""
    coded = (albedo - truth).abs()
    logs = torch.log(linear(albedo).clamp(min=DARKEST)) - torch.log(linear(truth).clamp(min=DARKEST))
    weight = mask / (mask.mean() + 1e-3)
    return ((coded + relative * logs.abs().clamp(max=2.0)) * weight).mean()


class DeltaTask:
    """Patches of textures as super-resolution hands them over, with a context that errs as the real one does.

    The context of a patch is the truth at the context's resolution, plus smooth errors; so both can be trained apart.
    """

    def __init__(self, data: Path, side: int = 256, names: tuple[str, ...] = Delta.channels) -> None:
        wanted = ("albedo", "texture", "mask", "geometry")
        self.train, self.test = Patches(data / "train", wanted), Patches(data / "held-out", wanted)
        self.side, self.names = side, names

    def refresh(self) -> None:
        """Read captures that came since the last time."""
        self.train.refresh()
        if not self.test.items:
            self.test.refresh()

    def batch(self, size: int, generator: torch.Generator) -> Batch:
        """Random crops."""
        batch = patch_batch(self.train, size, self.side, generator)
        batch["texture"] = gain(batch["texture"], generator)
        self._degrade(batch, generator)
        return batch

    def held_out(self) -> list[Batch]:
        """Fixed crops with fixed errors."""
        generator = torch.Generator().manual_seed(1)
        batches = fixed_batches(self.test, self.side)
        for batch in batches:
            self._degrade(batch, generator)
        return batches

    def seeds(self) -> list[int]:
        """The subject of each item of the held-out batches."""
        return [int(item["seed"]) for item in fixed_items(self.test)]

    def _degrade(self, batch: Batch, generator: torch.Generator) -> None:
        texture, albedo = batch["texture"], batch["albedo"]
        cells, size = cells_of(self.side), len(texture)
        light = context_light(texture, albedo, cells)
        amount = uniform(generator, 0.0, 0.16, size, 1, 1, 1)
        shared = smooth_field((size, 1, cells, cells), max(cells // 4, 2), generator)
        apart = smooth_field((size, 3, cells, cells), max(cells // 4, 2), generator)
        light = light + amount * (shared + 0.4 * apart)
        batch["context"] = functional.interpolate(light, texture.shape[2:], mode="bilinear", align_corners=False)
        share = uniform(generator, 0.0, 1.15, size, 1, 1, 1)
        factor = float(uniform(generator, *PHOTOS_DETAIL, 1))
        batch["albedo"] = lost_detail(albedo, share, factor).clamp(0.0, 1.0)
        batch["texture"] = noisy(lost_detail(texture, share, factor).clamp(0.0, 1.0), generator, 1.0 / 255.0)

    def predict(self, network: nn.Module, batch: Batch) -> Tensor:
        """Coded albedo in [0, 1]."""
        slow = channels(batch, tuple(n for n in self.names if n in GEOMETRY))
        inputs = torch.cat([batch["texture"] * 2.0 - 1.0, batch["context"], slow], 1)
        result: Tensor = network(inputs)
        return result * 0.5 + 0.5

    def loss(self, result: Tensor, batch: Batch) -> Tensor:
        """Of the albedo and of its differences between neighbours, which carry the detail."""
        truth, mask = batch["albedo"], batch["mask"]
        rows = (result.diff(dim=2) - truth.diff(dim=2)).abs().mean()
        columns = (result.diff(dim=3) - truth.diff(dim=3)).abs().mean()
        return albedo_loss(result, truth, mask) + 0.5 * (rows + columns)

    def measure(self, result: Tensor, batch: Batch) -> dict[str, float]:
        """PSNR of albedo: the network's, that of the context alone, and the texture's own."""
        truth, mask = batch["albedo"], batch["mask"]
        alone = psnr(unlit(batch["texture"], batch["context"]), truth, mask)
        return {
            "score": psnr(result, truth, mask),
            "context_alone": alone,
            "texture_itself": psnr(batch["texture"], truth, mask),
        }

    def sheet(self, result: Tensor, batch: Batch) -> Tensor:
        """Texture, result and truth one below the other."""
        rows = [batch["texture"], result.clamp(0.0, 1.0), batch["albedo"]]
        return torch.cat([torch.cat(list(row), 2) for row in rows], 1)
