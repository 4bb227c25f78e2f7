"""Task of delta's context: whole charts, and what the whites of the eyes would show of their light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from models.networks.configs import CONTEXT_CHANNELS
from models.training.albedo import albedo_loss, log_light, unlit
from models.training.cover import Cover
from models.training.degrade import blur, gain, graded, half_mirrored, noisy, smooth_field, tinted
from models.training.eyes import KNOWN, exposed, eye_light, face_zone, lid_zones
from models.training.facial_hair import Barber
from models.training.paint import Painter
from models.training.shadows import hard_light
from models.training.skins import darkened, recalibrated, relit
from models.training.store import Arrays, Wholes
from models.training.tasks import FLIPPED, MOST_HELD_OUT, Batch, byte, channels, choice, psnr, uniform
from service.runtime.network_registry import EYES

MISFITTED, MISFIT = 0.7, 0.8
"""Share of training charts whose head is told to be partly another's, as a fit errs, and the largest part of that: the
normals of fits are off by 11 degrees (``benchmarks.fit``), those of another head by 15."""

MISPLACED, WAVES = 1.5, (4, 8, 16)
"""Largest standard deviation of how far beside its place a fit lays a photo, texels (1.5 mm each); and how many of its
waves lie across a chart."""

UNSEEN = 0.2
"""Weight in training of skin that the photo does not show, which the network has to guess the light of."""

RELATIVE = 0.2
"""Weight of logarithms in the loss: by codes alone, an error on dark skin counts less than half as much."""

HELD_OUT_SEED = 11


def misfitted(geometry: Tensor, generator: torch.Generator) -> Tensor:
    """(N, 11, h, w) geometry channels of heads as fits see them: each a little like the next one in the batch."""
    n = len(geometry)
    part = uniform(generator, 0.0, MISFIT, n, 1, 1, 1) * (torch.rand(n, 1, 1, 1, generator=generator) < MISFITTED)
    return geometry + part * (geometry.roll(1, 0) - geometry)


def misplaced(planes: list[Tensor], generator: torch.Generator) -> list[Tensor]:
    """Planes (N, C, h, w), all moved alike by smooth distances, as fits lay a photo beside its place on the chart."""
    n, _, height, width = planes[0].shape
    amount = uniform(generator, 0.0, MISPLACED, n, 1, 1, 1)
    moved = amount * smooth_field((n, 2, height, width), WAVES[choice(generator, len(WAVES))], generator)
    along = moved.permute(0, 2, 3, 1) * torch.tensor([2.0 / width, 2.0 / height])
    plain = torch.eye(2, 3).expand(n, 2, 3)
    grid = functional.affine_grid(plain, [n, 1, height, width], align_corners=False) + along
    return [functional.grid_sample(p, grid, padding_mode="border", align_corners=False) for p in planes]


def best_gain(light: Tensor, batch: Batch) -> Tensor:
    """(N, 3, 1, 1) by how much a log light (N, 3, h, w) is too bright on the seen skin of each chart."""
    lit = batch["lit"]
    apart = light - log_light(batch["clean"], batch["albedo"])
    return (apart * lit).sum((2, 3), keepdim=True) / lit.sum((2, 3), keepdim=True).clamp(min=1.0)


class ContextTask:
    """Whole charts, degraded as the fitting degrades them, with the light that the whites of the eyes would show."""

    def __init__(self, data: Path) -> None:
        self.train, self.test = Wholes(data / "train"), Wholes(data / "held-out")
        self.lids, self.face = lid_zones(), face_zone()
        self.painter, self.barber, self.cover = Painter(), Barber(), Cover()

    def refresh(self) -> None:
        """Read captures that came since the last time."""
        self.train.refresh()
        if not self.test.items:
            self.test.refresh()

    def batch(self, size: int, generator: torch.Generator) -> Batch:
        """Random charts under random lights of theirs."""
        items, others = self._picked(size, generator), self._picked(size, generator)
        lights = torch.rand(size, generator=generator).tolist()
        batch = self.of([(item, int(at * len(item["texture"]))) for item, at in zip(items, lights, strict=True)])
        skin = byte(np.stack([other["albedo"] for other in others]))
        drawn = (batch["texture"], batch["albedo"])
        batch["texture"], batch["albedo"] = relit(*drawn, skin, batch["geometry"][:, -1:], generator)
        flip = torch.rand(size, 1, 1, 1, generator=generator) < 0.5
        batch["whites"] = torch.where(flip[..., 0], batch["whites"].flip(1), batch["whites"])
        for name in batch.keys() - {"whites"}:
            signs = FLIPPED.to(flip.device).view(1, -1, 1, 1) if name == "geometry" else 1.0
            batch[name] = torch.where(flip, batch[name].flip(-1) * signs, batch[name])
        if torch.rand(1, generator=generator) < 0.35:
            names = ["texture", "albedo"]
            mirrored = half_mirrored([batch[n] for n in names], generator, [None, None])
            batch.update(zip(names, mirrored, strict=True))
        batch["texture"], batch["albedo"] = self.painter(batch["texture"], batch["albedo"], generator)
        for shade in (darkened, recalibrated):
            batch["texture"], batch["albedo"] = shade(batch["texture"], batch["albedo"], generator)
        batch["texture"], batch["albedo"], beard = self.barber(batch["texture"], batch["albedo"], generator)
        texture = tinted(hard_light(batch["texture"], batch["geometry"], generator), generator)
        open_ = batch["whites"].isfinite().all(2).any(1)
        known = (torch.rand(size, generator=generator) < KNOWN).float() * open_
        texture = exposed(texture, batch["albedo"], self.face, 1.0 - known, generator)
        texture = graded(gain(texture, generator), generator)
        texture, batch["albedo"], beard = misplaced([texture, batch["albedo"], beard], generator)
        batch["clean"] = texture
        batch["eyes"] = eye_light(log_light(texture, batch["albedo"]), self.lids, batch["whites"], known, generator)
        texture = blur(texture, float(uniform(generator, -0.4, 0.9, 1)))
        batch["texture"] = noisy(texture, generator)
        batch["seen"] = self.cover(batch["geometry"], generator)
        batch["lit"] = self.cover.measurable(batch["seen"], beard, generator)
        batch["geometry"] = misfitted(batch["geometry"], generator)
        return batch

    def held_out(self) -> list[Batch]:
        """Two lights of each held-out capture."""
        pairs = [(item, light) for item in self.test.items for light in (0, 1)][:MOST_HELD_OUT]
        generator = torch.Generator(torch.get_default_device()).manual_seed(HELD_OUT_SEED)
        batches = [self.of(pairs[i : i + 4]) for i in range(0, len(pairs), 4)]
        for batch in batches:
            batch["texture"], batch["albedo"] = recalibrated(batch["texture"], batch["albedo"], generator)
            batch["clean"] = batch["texture"]
            light = log_light(batch["texture"], batch["albedo"])
            batch["eyes"] = eye_light(light, self.lids, batch["whites"], torch.ones(len(light)), generator)
            batch["lit"] = batch["seen"] = self.cover(batch["geometry"], generator)
        return batches

    def predict(self, network: nn.Module, batch: Batch) -> Tensor:
        """log(texture / albedo)."""
        texture = batch["texture"] * 2.0 - 1.0
        eyes = batch["eyes"][:, :, None, None].expand(-1, -1, *texture.shape[2:])
        geometry = channels(batch, CONTEXT_CHANNELS[3 + len(EYES) : -1])
        inputs = torch.cat([texture, eyes, geometry, batch["lit"]], 1)
        result: Tensor = network(inputs)
        return result

    def loss(self, result: Tensor, batch: Batch) -> Tensor:
        """Of the albedo that follows, and of the same after the best gain of each chart.

        How bright skin is cannot be told well; without the second part that would drown what light does to its shape.
        """
        weight = batch["seen"] + UNSEEN * (channels(batch, ("mask",)) - batch["seen"])
        lights = (result, result - best_gain(result, batch))
        plain, evenly = (
            albedo_loss(unlit(batch["clean"], light), batch["albedo"], weight, RELATIVE) for light in lights
        )
        return plain + evenly

    def measure(self, result: Tensor, batch: Batch) -> dict[str, float]:
        """PSNR of the albedo of seen skin: the network's, its after the best gain, and the texture's own."""
        lit, albedo = batch["seen"], batch["albedo"]
        evenly = unlit(batch["clean"], result - best_gain(result, batch))
        return {
            "score": psnr(unlit(batch["clean"], result), albedo, lit),
            "best_gain": psnr(evenly, albedo, lit),
            "texture_itself": psnr(batch["texture"], albedo, lit),
        }

    def sheet(self, result: Tensor, batch: Batch) -> Tensor:
        """Texture, result and truth one below the other."""
        rows = [batch["texture"], unlit(batch["clean"], result), batch["albedo"]]
        return torch.cat([torch.cat(list(row[:3]), 2) for row in rows], 1)

    def _picked(self, count: int, generator: torch.Generator) -> list[Arrays]:
        index = torch.randint(len(self.train.items), (count,), generator=generator)
        return [self.train.items[i] for i in index.tolist()]

    def seeds(self) -> list[int]:
        """The subject of each item of the held-out batches."""
        return [int(item["seed"]) for item in self.test.items for _ in (0, 1)][:MOST_HELD_OUT]

    @staticmethod
    def of(pairs: list[tuple[Arrays, int]]) -> Batch:
        """Charts of (capture, light), all of whose skin is seen."""
        texture = byte(np.stack([item["texture"][light] for item, light in pairs]))
        geometry = torch.as_tensor(np.stack([item["geometry"] for item, _ in pairs])).float()
        albedo = byte(np.stack([item["albedo"] for item, _ in pairs]))
        whites = torch.as_tensor(np.stack([item["whites"][light] for item, light in pairs])).float()
        batch = {"texture": texture, "clean": texture, "albedo": albedo, "geometry": geometry, "lit": geometry[:, -1:]}
        return batch | {"whites": whites}
