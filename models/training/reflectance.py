"""What the tasks of psi, rho and sigma share: crops of diffuse albedo a little off, and the strength of fine detail."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional

from models.training.degrade import blur, gain, noisy
from models.training.store import Patches
from models.training.tasks import Batch, fixed_batches, fixed_items, patch_batch, uniform
from service.colour import LUMA

STRENGTH_WINDOW = 16
"""Texels over which the strength of relief is compared."""


def local_strength(slopes: Tensor, window: int = STRENGTH_WINDOW) -> Tensor:
    """(N, 1, h, w) root mean square of slopes (N, C, h, w) around each texel, in squares of ``window`` texels.

    Where colour says little about a pore's place, the least error is a flat map. Skin is not flat; so the strength of
    its relief is asked for by itself.
    """
    power = slopes.square().sum(1, keepdim=True)
    pooled = functional.avg_pool2d(power, window, window // 2)
    around = functional.interpolate(pooled, slopes.shape[2:], mode="bilinear", align_corners=False)
    return (around + 1e-6).sqrt()


def grey(albedo: Tensor) -> Tensor:
    """(N, 1, h, w) luma of coded albedo."""
    return (albedo * torch.from_numpy(LUMA).float().view(1, 3, 1, 1)).sum(1, keepdim=True)


class AlbedoTask:
    """Crops whose albedo is a little off, as delta's is."""

    wanted: tuple[str, ...]

    def __init__(self, data: Path, side: int = 256) -> None:
        wanted = ("albedo", "mask", "hair", "geometry", *self.wanted)
        self.train, self.test = (Patches(data / part, wanted, unlit_too=True) for part in ("train", "held-out"))
        self.side = side

    def refresh(self) -> None:
        """Read captures that came since the last time."""
        self.train.refresh()
        if not self.test.items:
            self.test.refresh()

    def batch(self, size: int, generator: torch.Generator) -> Batch:
        """Random crops."""
        batch = self._crops(size, generator)
        albedo = gain(batch["albedo"], generator, 0.08)
        albedo = blur(albedo, float(uniform(generator, -1.0, 0.5, 1)))
        batch["albedo"] = noisy(albedo, generator, 1.0 / 255.0)
        return batch

    def held_out(self) -> list[Batch]:
        """Fixed crops, clean."""
        return fixed_batches(self.test, self.side)

    def seeds(self) -> list[int]:
        """The subject of each item of the held-out batches."""
        return [int(item["seed"]) for item in fixed_items(self.test)]

    def _crops(self, size: int, generator: torch.Generator) -> Batch:
        return patch_batch(self.train, size, self.side, generator)
