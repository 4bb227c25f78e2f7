"""Task of psi: specular albedo from diffuse albedo."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from models.colour import linear, srgb
from models.lightstage.skin.subject import Subject
from models.networks.stages import Psi
from models.training.coverings import Coverings
from models.training.degrade import blur
from models.training.reflectance import STRENGTH_WINDOW, AlbedoTask, local_strength
from models.training.store import Arrays
from models.training.tasks import Batch, byte, channels
from service.runtime.network_registry import GEOMETRY

TONE, MELANIN = 0.6, (0.8, 1.1, 1.25)
"""Standard deviation of the logarithm by which crops for psi change their tone, and how much more blue changes: what
reflects at the surface does not depend on pigment."""

STRENGTH_WEIGHT = 0.4
"""What the strength of detail counts for beside its place, in each octave."""

OCTAVES = (1.0, 2.0, 4.0, 8.0)
"""Standard deviations, texels, of the blurs between which an octave lies. Asked for the strength of all detail at once,
psi gave all of it as dots, which cost the least: the finest octave far too strong, the others missing."""


def octaves(image: Tensor) -> list[Tensor]:
    """(N, C, h, w) parts of an image: finer than the first of ``OCTAVES``, and between each and the next."""
    smooth = [image, *(blur(image, size) for size in OCTAVES)]
    return [fine - coarse for fine, coarse in pairwise(smooth)]


def strength_error(result: Tensor, truth: Tensor, weight: Tensor) -> Tensor:
    """Mean difference of the strength of detail, octave by octave; windows are some waves wide in each."""
    errors = []
    for size, one, other in zip(OCTAVES, octaves(result), octaves(truth), strict=True):
        window = min(max(STRENGTH_WINDOW, int(8 * size)), result.shape[2] // 2, result.shape[3] // 2)
        errors.append(((local_strength(one, window) - local_strength(other, window)).abs() * weight).mean())
    return torch.stack(errors).sum()


def retoned(albedo: Tensor, generator: torch.Generator) -> Tensor:
    """sRGB-coded albedo (N, 3, h, w), each made darker or lighter, as more or less melanin would."""
    depth = TONE * torch.randn(len(albedo), 1, 1, 1, generator=generator)
    channel = torch.tensor(MELANIN).view(1, 3, 1, 1)
    return srgb((linear(albedo) * torch.exp(-depth * channel)).clamp(0.0, 1.0))


def of_usual_gloss(item: Arrays) -> Arrays:
    """A patch as it would be if its subject were as glossy as most.

    How much one person reflects more than another as a whole is not to be seen in the diffuse albedo. A network that is
    asked for it learns which of the training subjects a tone belongs to.
    """
    scale = Subject.sample(int(item["seed"])).gloss.scale
    usual = np.clip(np.rint(item["specular"].astype(np.float32) / scale), 0, 255).astype(np.uint8)
    return {**item, "specular": usual}


class PsiTask(AlbedoTask):
    """Diffuse albedo -> specular albedo."""

    wanted = ("specular",)
    usual = 0.5
    """Mean over the training subjects: the best that can be said without looking."""

    def __init__(self, data: Path, side: int = 256) -> None:
        super().__init__(data, side)
        self.coverings = Coverings()

    def refresh(self) -> None:
        """Read captures that came since the last time; how glossy its subject is is taken out of each."""
        known = len(self.train.items)
        super().refresh()
        self.train.items[known:] = [of_usual_gloss(item) for item in self.train.items[known:]]
        maps = [(byte(item["mask"]) > 0.5, byte(item["specular"])) for item in self.train.items]
        count = sum(float(inside.sum()) for inside, _ in maps)
        self.usual = sum(float((values * inside).sum()) for inside, values in maps) / max(count, 1.0)

    def batch(self, size: int, generator: torch.Generator) -> Batch:
        """Random crops, each of another tone."""
        batch = super().batch(size, generator)
        batch["albedo"] = retoned(batch["albedo"], generator)
        return batch

    def _crops(self, size: int, generator: torch.Generator) -> Batch:
        """With pigment that is no gloss, and hair and lipstick that are."""
        return self.coverings(super()._crops(size, generator), generator)

    def predict(self, network: nn.Module, batch: Batch) -> Tensor:
        """Specular albedo in [0, 1]."""
        slow = channels(batch, tuple(n for n in Psi.channels if n in GEOMETRY))
        result: Tensor = network(torch.cat([batch["albedo"] * 2.0 - 1.0, slow], 1))
        return result * 0.5 + 0.5

    def loss(self, result: Tensor, batch: Batch) -> Tensor:
        """L1, of differences between neighbours, and of how strong the detail is, octave by octave."""
        truth, mask = batch["specular"], batch["mask"]
        weight = mask / (mask.mean() + 1e-3)
        edges = sum((result.diff(dim=d) - truth.diff(dim=d)).abs().mean() for d in (2, 3))
        strength = strength_error(result, truth, weight)
        return ((result - truth).abs() * weight).mean() + 0.5 * edges + STRENGTH_WEIGHT * strength

    def measure(self, result: Tensor, batch: Batch) -> dict[str, float]:
        """Mean absolute error; that of the usual value; both if the true mean were known, which glossy people change.

        ``detail <i>`` is the share of the strength of each octave, from the finest on.
        """
        truth, mask = batch["specular"], batch["mask"]
        count = mask.sum() + 1e-6

        def error(found: Tensor | float) -> float:
            return float(((found - truth).abs() * mask).sum() / count)

        mean, own = ((x * mask).sum() / count for x in (truth, result))
        ours, theirs = ([(part * mask).square().mean().sqrt() for part in octaves(x)] for x in (result, truth))
        shares = {f"detail {i + 1}": float(a / (b + 1e-9)) for i, (a, b) in enumerate(zip(ours, theirs, strict=True))}
        return {
            "score": -error(result), "flat": -error(self.usual), "true_mean": -error(result + (mean - own)),
            "flat_true_mean": -error(float(mean)), **shares,
        }  # fmt: skip

    def sheet(self, result: Tensor, batch: Batch) -> Tensor:
        """Albedo, result and truth one below the other."""
        rows = [batch["albedo"], result.expand(-1, 3, -1, -1), batch["specular"].expand(-1, 3, -1, -1)]
        return torch.cat([torch.cat(list(row), 2) for row in rows], 1)
