"""Task of rho and sigma: specular and diffuse normals from grey albedo and the normals of the shape."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from models.colour import linear, srgb
from models.networks.stages import Rho, Sigma
from models.training.albedo import cells_of, context_light, log_light
from models.training.creases import Creases
from models.training.degrade import PHOTOS_DETAIL, blur, lost_detail
from models.training.reflectance import AlbedoTask, grey, local_strength
from models.training.tasks import Batch, channels, uniform
from service.runtime.network_registry import GEOMETRY

MOST_SHADE, SHADE_POWER, SHADE_MEASURED = 1.1, 0.35, 1.0
"""What is left of the fine shade, finer than delta's context tells, in the albedo that rho and sigma train on: at most
this share, of a power of chance that makes shares near the whole the usual ones; and the share in held-out albedo.
The service hands over all of it (``service.reflectance.relief.normal_inputs``): a crease of the photo stays a dark
line."""
COARSEST = 3.0
"""The context's light is smoother than its cells: its cells are up to so many times as large in training, so that
more shade is left. In held-out albedo they have their size."""
DETAIL_MEASURED = 8.0
"""Value of ``PHOTOS_DETAIL`` in held-out albedo: none of the shade finer than that is there."""

STRENGTH_WEIGHT = 1.0
"""What the strength of relief counts for beside its place where the detail is drawn: there nobody knows the place, and
skin is not flat. On a photo's skin it does not count: relief in a wrong place is worse than none."""

HAIR_WEIGHT = 0.6
"""Normals of hair are half chance; they count less. Not much less: strands must not be taken for creases."""


def shaded(
    albedo: Tensor, texture: Tensor, share: Tensor, finest: Tensor, factor: float, coarser: float = 1.0
) -> Tensor:
    """sRGB-coded albedo (N, 3, h, w) with a share (N, 1, 1, 1) of the fine shade of its texture.

    Args:
        albedo: of a patch.
        texture: of it in some light.
        share: of its shade that is left.
        finest: (N, 1, 1, 1) share of that which is finer than ``factor`` texels.
        factor: see ``PHOTOS_DETAIL``.
        coarser: times the context's cells; shade finer than that is fine.
    """
    light = log_light(texture, albedo)
    coarse = context_light(texture, albedo, max(round(cells_of(albedo.shape[2]) / coarser), 2))
    fine = light - functional.interpolate(coarse, albedo.shape[2:], mode="bilinear", align_corners=False)
    fine = lost_detail(fine.clamp(-2.0, 2.0), finest, factor)
    return srgb((linear(albedo) * torch.exp(share * fine)).clamp(0.0, 1.0))


def angles(found: Tensor, truth: Tensor) -> Tensor:
    """(N, 1, h, w) degrees between unit normals."""
    cosine = (found * truth).sum(1, keepdim=True)
    sine = torch.linalg.cross(found, truth, dim=1).square().sum(1, keepdim=True).sqrt()
    return torch.rad2deg(torch.atan2(sine, cosine))


MISPLACED, MARK_SIZE = 0.85, 24.0
"""Share of a photo's crops whose pigment lies in other places than their relief, and the standard deviation, texels, of
the blur that takes it off. The stage's colour follows its height: correlation 0.3 (light skin) to 0.44 from 0.3 to
1 mm, where scans have -0.1 to 0.2 (docs/lightstage.md); with this share crops have about the scans' mean. A network
that has seen the stage alone reads relief off colour on every skin; one that has seen both gives, where it cannot tell,
what is likeliest: next to none. Shade stays where its relief is, and creases are dark. Where super-resolution drew the
detail, colour follows height as on the stage, and the network is told so
(``service.reflectance.relief.normal_inputs``)."""


def misplaced_pigment(albedo: Tensor, hair: Tensor, share: Tensor) -> Tensor:
    """(N, 3, h, w) factor of linear albedo after which its fine detail is that of the same crop turned by 180 degrees.

    Args:
        albedo: (N, 3, h, w) sRGB-coded.
        hair: (N, 1, h, w) in [0, 1]; hair stays where it is, and is not turned onto skin.
        share: (N, 1, 1, 1) in [0, 1], how far; 0 gives 1 everywhere.
    """
    tone = torch.log(linear(albedo).clamp(min=1e-3))
    size = min(MARK_SIZE, min(tone.shape[2:]) / 6)  # no wider than small crops allow
    fine = (tone - blur(tone, size)) * (1.0 - hair)
    bare = 1.0 - torch.maximum(hair, hair.flip(-1, -2))
    return torch.exp(share * bare * (fine.flip(-1, -2) - fine))


class NormalTask(AlbedoTask):
    """Grey albedo and shape normals -> normals."""

    def __init__(self, data: Path, target: str, side: int = 256) -> None:
        self.target, self.wanted = target, (target, "texture")
        self.slow = tuple(n for n in (Rho if target == "specular_normal" else Sigma).channels if n in GEOMETRY)
        super().__init__(data, side)

    def batch(self, size: int, generator: torch.Generator) -> Batch:
        """Random crops, most of which have creases drawn over them."""
        return self.creased(super().batch(size, generator), generator)

    def creased(self, batch: Batch, generator: torch.Generator) -> Batch:
        """The same crops, most of them with creases drawn over them."""
        creases = Creases.draw(len(batch["albedo"]), self.side, batch["chart_width"], batch["hair"], generator)
        normal = creases.onto(batch[self.target], diffuse=self.target == "diffuse_normal")
        return {**batch, "albedo": creases.seen(batch["albedo"]), self.target: normal}

    def held_out(self) -> list[Batch]:
        """Fixed crops without noise, with the shade of a photo's detail; ``bare_albedo`` is without it.

        Their colour follows their height, as that of drawn detail does.
        """
        batches = super().held_out()
        for batch in batches:
            share, none = torch.full((len(batch["albedo"]), 1, 1, 1), SHADE_MEASURED), torch.zeros(1, 1, 1, 1)
            batch["bare_albedo"], batch["drawn"] = batch["albedo"], torch.ones_like(share)
            batch["albedo"] = shaded(batch["albedo"], batch["texture"], share, none, DETAIL_MEASURED)
        return batches

    def _crops(self, size: int, generator: torch.Generator) -> Batch:
        """With fine shade left in the albedo, which tells of relief as much as colour does."""
        batch = super()._crops(size, generator)
        share, finest = (uniform(generator, 0.0, 1.0, size, 1, 1, 1) for _ in range(2))
        share = MOST_SHADE * share**SHADE_POWER
        factor, coarser = (float(uniform(generator, *span, 1)) for span in (PHOTOS_DETAIL, (1.0, COARSEST)))
        # A third of the crops is the photo's, a third is drawn, the others are partly so.
        drawn = uniform(generator, -1.0, 2.0, size, 1, 1, 1).clamp(0.0, 1.0)
        here = (uniform(generator, 0.0, 1.0, size, 1, 1, 1) < MISPLACED * (1.0 - drawn)).float()
        moved = misplaced_pigment(batch["albedo"], batch["hair"], here)
        seen = shaded(batch["albedo"], batch["texture"], share, finest, factor, coarser)
        batch["albedo"] = srgb((linear(seen) * moved).clamp(0.0, 1.0))
        return batch | {"drawn": drawn}

    def predict(self, network: nn.Module, batch: Batch) -> Tensor:
        """Unit normals."""
        shown = grey(batch["albedo"]) * 2.0 - 1.0
        drawn = (batch["drawn"] * 2.0 - 1.0).expand_as(shown)
        inputs = torch.cat([shown, channels(batch, self.slow), drawn], 1)
        result: Tensor = network(inputs)
        return result

    def loss(self, result: Tensor, batch: Batch) -> Tensor:
        """L1 of slopes, of their differences between neighbours, 1 - cosine; of drawn detail its strength as well."""
        truth = batch[self.target]
        weight = batch["mask"] * (1.0 - (1.0 - HAIR_WEIGHT) * batch["hair"])
        weight = weight / (weight.mean() + 1e-3)
        found, wanted = (n[:, :2] / n[:, 2:].clamp(min=0.1) for n in (result, truth))
        slopes = ((found - wanted).abs() * weight).mean()
        edges = sum(((found.diff(dim=d) - wanted.diff(dim=d)).abs()).mean() for d in (2, 3))
        cosine = ((1.0 - (result * truth).sum(1, keepdim=True)) * weight).mean()
        strength = ((local_strength(found) - local_strength(wanted)).abs() * weight * batch["drawn"]).mean()
        return slopes + 0.5 * edges + cosine + STRENGTH_WEIGHT * strength

    def measure(self, result: Tensor, batch: Batch) -> dict[str, float]:
        """Mean angle against that of the flat map; share of fine detail; correlation of fine slopes."""
        truth = batch[self.target]
        weight = batch["mask"] * (batch["hair"] < 0.3)
        count = weight.sum() + 1e-6
        flat = torch.zeros_like(truth)
        flat[:, 2] = 1.0
        error, none = (float((angles(n, truth) * weight).sum() / count) for n in (result, flat))
        fine = [(n[:, :2] / n[:, 2:].clamp(min=0.1)) for n in (result, truth)]
        fine = [(n - blur(n, 6.0)) * weight for n in fine]
        a, b = (n.flatten() for n in fine)
        correlation = float((a * b).sum() / ((a * a).sum() * (b * b).sum()).sqrt().clamp(min=1e-9))
        return {
            "score": -error, "flat": -none, "detail": float(a.std() / (b.std() + 1e-9)), "correlation": correlation
        }  # fmt: skip

    def sheet(self, result: Tensor, batch: Batch) -> Tensor:
        """Albedo, result and truth one below the other."""
        rows = [batch["albedo"], result * 0.5 + 0.5, batch[self.target] * 0.5 + 0.5]
        return torch.cat([torch.cat(list(row), 2) for row in rows], 1)
