"""Held-out results of the shipped networks beside simple baselines: ``python -m models.training.evaluate --data DIR``.

The networks are the ONNX files that the service runs. Subjects and lights are those that training never saw. Results
are given for all subjects and by skin tone (individual typology angle). ``--write FILE`` puts the tables between the
lines ``<!-- held-out -->`` and ``<!-- /held-out -->`` of a Markdown file.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer
from torch import Tensor, nn
from torch.nn import functional

from models.colour import linear, srgb
from models.lightstage.tones import TONES, tone
from models.networks.configs import NETWORKS, build
from models.networks.rcan import with_detail
from models.networks.stages import StageNet
from models.tables import write_between
from models.training.albedo import unlit
from models.training.context import ContextTask, best_gain
from models.training.degrade import blur
from models.training.measures import colour_difference, light_left
from models.training.normals import NormalTask, angles, misplaced_pigment
from models.training.reflectance import grey
from models.training.specular_albedo import PsiTask
from models.training.tasks import Batch, Task, channels, psnr
from models.training.train import TASKS
from service.runtime.networks import Engine, open_network
from service.runtime.sessions import MODELS

MARK = ("<!-- held-out -->", "<!-- /held-out -->")
CREASES_SEED, COVERINGS_SEED = 17, 19

EVALUATED = ("delta_context", "delta", "psi", "rho", "sigma", "zeta")

Row = dict[str, float]
Table = dict[str, dict[str, list[float]]]


class Shipped(nn.Module):
    """An ONNX file of the service as a torch module."""

    def __init__(self, name: str, folder: Path) -> None:
        super().__init__()
        self.name, self.engine = name, Engine(threads=1, folder=folder)
        like = build(name) if name in NETWORKS else None
        self.prepared = like.prepared if isinstance(like, StageNet) else nn.Identity()
        self.finished = like.finished if isinstance(like, StageNet) else nn.Identity()

    def forward(self, maps: Tensor) -> Tensor:
        """(N, C, h, w) -> (N, K, h', w')."""
        with open_network(self.name, self.engine) as network:
            around = nn.functional.pad(self.prepared(maps), (network.description.margin,) * 4, "reflect")
            return self.finished(torch.stack([torch.from_numpy(network.run(item.numpy())) for item in around]))


class ShippedZeta(nn.Module):
    """Body and tail."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.body, self.tail = Shipped("zeta_body", folder), Shipped("zeta_tail", folder)

    def forward(self, maps: Tensor, noise: Tensor) -> Tensor:
        """(N, 7, h, w) and noise -> (N, 3, 8h, 8w)."""
        return with_detail(maps[:, :3], self.tail(torch.cat([self.body(maps), noise], 1)))


def flat_colour(texture: Tensor, albedo: Tensor, mask: Tensor) -> float:
    """PSNR of one flat colour that knows the true mean: what no de-lighting network may stay below."""
    mean = (albedo * mask).sum((2, 3), keepdim=True) / (mask.sum((2, 3), keepdim=True) + 1e-6)
    return psnr(mean.expand_as(albedo), albedo, mask)


def divided(batch: Batch) -> Tensor:
    """Albedo by the classic way: the texture over its smooth shading, brought to the texture's own mean brightness.

    The shading is the best fit of second-degree harmonics of the normal to the texture's luminance.
    """
    texture, mask = batch["clean"], batch["lit"]
    result = []
    normals = channels(batch, ("normal_object_x", "normal_object_y", "normal_object_z"))
    for image, normal, inside in zip(texture, normals, mask, strict=True):
        x, y, z = normal
        basis = torch.stack([torch.ones_like(x), x, y, z, x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y])
        bright = image.clamp(min=1e-3) ** 2.2
        chosen = inside[0] > 0.5
        a, b = basis[:, chosen].T, grey(bright[None])[0, 0][chosen]
        fitted = torch.linalg.lstsq(a, b[:, None]).solution[:, 0]
        shading = torch.einsum("khw,k->hw", basis, fitted).clamp(min=float(b.mean()) * 0.1)
        result.append((bright / shading * b.mean()).clamp(0.0, 1.0) ** (1.0 / 2.2))
    return torch.stack(result)


def context_rows(task: ContextTask, network: nn.Module) -> Callable[[Batch], Row]:
    """Albedo of the skin that a photo would show by its low-frequency light alone."""

    def measure(batch: Batch) -> Row:
        light = task.predict(network, batch)
        mask, everything = batch["lit"], channels(batch, ("mask",))
        albedo = batch["albedo"]
        found = unlit(batch["clean"], light)
        bare = unlit(batch["clean"], task.predict(network, batch | {"lit": everything}))
        blind = task.predict(network, batch | {"eyes": torch.zeros_like(batch["eyes"])})
        gain, gain_blind = (best_gain(one, batch) for one in (light, blind))
        return {
            "network dB": psnr(found, albedo, mask),
            "network, no eyes seen dB": psnr(unlit(batch["clean"], blind), albedo, mask),
            "network, best gain dB": psnr(unlit(batch["clean"], light - gain), albedo, mask),
            "network, all skin seen dB": psnr(bare, albedo, everything),
            "network, Delta E 2000": colour_difference(found, albedo, mask),
            "network, light left": light_left(found, albedo, batch["clean"], mask),
            "log light off by": abs(float(gain.mean())),
            "log light off by, no eyes seen": abs(float(gain_blind.mean())),
            "texture itself dB": psnr(batch["texture"], albedo, mask),
            "texture itself, Delta E 2000": colour_difference(batch["texture"], albedo, mask),
            "divided by shading dB": psnr(divided(batch), albedo, mask),
            "one true colour dB": flat_colour(batch["texture"], albedo, mask),
        }

    return measure


def dark_is_deep(batch: Batch) -> Tensor:
    """Normals of a surface whose height is the grey albedo, as strong as the truth's fine slopes are on average."""
    height = blur(grey(batch["albedo"]), 0.7)
    fine = height - blur(height, 6.0)
    padded = functional.pad(fine, (1, 1, 1, 1), mode="reflect")
    p = -(padded[..., 1:-1, 2:] - padded[..., 1:-1, :-2])
    q = padded[..., 2:, 1:-1] - padded[..., :-2, 1:-1]
    slopes = torch.cat([p, q], 1)
    slopes = slopes * (0.12 / (slopes.std() + 1e-9))
    normal = torch.cat([slopes, torch.ones_like(p)], 1)
    return normal / normal.square().sum(1, keepdim=True).sqrt()


def normal_rows(task: NormalTask, network: nn.Module) -> Callable[[Batch], Row]:
    """Angles and detail of normals, as they are and with creases drawn over the skin."""
    generator = torch.Generator().manual_seed(CREASES_SEED)

    def measure(batch: Batch) -> Row:
        truth = batch[task.target]
        numbers = task.measure(task.predict(network, batch), batch)
        weight = batch["mask"] * (batch["hair"] < 0.3)
        soft = blur(truth, 6.0)
        soft = soft / soft.square().sum(1, keepdim=True).sqrt()
        count = weight.sum() + 1e-6

        def mean_angle(normal: Tensor) -> float:
            return float((angles(normal, truth) * weight).sum() / count)

        deep = task.measure(dark_is_deep(batch), batch)
        creased = task.creased(batch, generator)
        lines = task.measure(task.predict(network, creased), creased)
        whole = torch.ones(len(truth), 1, 1, 1)
        moved = linear(batch["albedo"]) * misplaced_pigment(batch["bare_albedo"], batch["hair"], whole)
        other = batch | {"albedo": srgb(moved.clamp(0.0, 1.0)), "drawn": torch.zeros_like(whole)}
        strange = task.measure(task.predict(network, other), other)
        return {
            "network deg": -numbers["score"], "flat deg": -numbers["flat"], "blurred truth deg": mean_angle(soft),
            "dark is deep deg": -deep["score"], "detail": numbers["detail"], "correlation": numbers["correlation"],
            "dark is deep correlation": deep["correlation"], "creased: network deg": -lines["score"],
            "creased: flat deg": -lines["flat"], "creased: correlation": lines["correlation"],
            "pigment elsewhere: network deg": -strange["score"],
            "pigment elsewhere: correlation": strange["correlation"],
        }  # fmt: skip

    return measure


def gloss_rows(task: PsiTask, network: nn.Module) -> Callable[[Batch], Row]:
    """Of specular albedo, as it is, and with pigment and with hair and lipstick painted over the crops."""
    generator = torch.Generator().manual_seed(COVERINGS_SEED)
    plain = plain_rows(task, network)

    def measure(batch: Batch) -> Row:
        painted, covered = task.coverings.pigmented(batch, generator), task.coverings.covered(batch, generator)
        shown, under, over = (task.predict(network, one) for one in (batch, painted, covered))
        moved = ((under - shown).abs() * batch["mask"]).sum() / (batch["mask"].sum() + 1e-6)
        return plain(batch) | {
            "pigment painted: network": -task.measure(under, painted)["score"],
            "pigment painted: differs from unpainted": float(moved),
            "hair and lipstick: network": -task.measure(over, covered)["score"],
            "hair and lipstick: as if unpainted": -task.measure(shown, covered)["score"],
        }

    return measure


def plain_rows(task: Task, network: nn.Module) -> Callable[[Batch], Row]:
    """What the task itself measures."""

    def measure(batch: Batch) -> Row:
        numbers = task.measure(task.predict(network, batch), batch)
        return {("network" if name == "score" else name): abs(value) for name, value in numbers.items()}

    return measure


def tabulate(batches: list[Batch], seeds: list[int], measure: Callable[[Batch], Row]) -> Table:
    """Numbers by row and skin tone; one batch per item."""
    result: Table = defaultdict(lambda: defaultdict(list))
    for batch, seed in zip(batches, seeds, strict=True):
        for name, value in measure(batch).items():
            result[name]["all"].append(value)
            result[name][tone(seed)].append(value)
    return result


def single(batches: list[Batch]) -> list[Batch]:
    """Batches of one."""
    return [
        {name: values[i : i + 1] for name, values in batch.items()}
        for batch in batches
        for i in range(len(next(iter(batch.values()))))
    ]


def as_markdown(title: str, table: Table) -> str:
    """Medians by row and tone."""
    tones = ["all", *(name for name, _, _ in TONES)]
    counts = {t: len(next(iter(table.values())).get(t, [])) for t in tones}
    shown = [t for t in tones if counts[t]]
    lines = [f"**{title}**", "", "| median | " + " | ".join(f"{t} ({counts[t]})" for t in shown) + " |"]
    lines.append("|---" * (len(shown) + 1) + "|")
    for name, by_tone in table.items():
        lines.append(f"| {name} | " + " | ".join(f"{np.median(by_tone[t]):.3g}" for t in shown) + " |")
    return "\n".join(lines) + "\n"


def evaluate(network: str, data: Path, folder: Path) -> str:
    """Table of one network."""
    module = ShippedZeta(folder) if network == "zeta" else Shipped(network, folder)
    with torch.no_grad():
        if network == "delta_context":
            task = ContextTask(data)
            task.refresh()
            batches = single(task.held_out())
            table = tabulate(batches, task.seeds(), context_rows(task, module))
            return as_markdown("delta's context: albedo of whole charts", table)
        other = TASKS[network](data, 256)
        other.refresh()
        batches = single(other.held_out())
        seeds = other.seeds()
        if isinstance(other, NormalTask):
            rows = normal_rows(other, module)
        elif isinstance(other, PsiTask):
            rows = gloss_rows(other, module)
        else:
            rows = plain_rows(other, module)
        return as_markdown(network, tabulate(batches, seeds, rows))


def main(
    data: Annotated[Path, typer.Option(help="Folder of captures, with held-out ones.")],
    networks: Annotated[str, typer.Option(help="Names, with commas between.")] = ",".join(EVALUATED),
    folder: Annotated[Path, typer.Option(help="Folder of the ONNX files.")] = MODELS,
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the tables into.")] = None,
) -> None:
    """Print the tables."""
    torch.set_num_threads(1)
    tables = []
    for name in networks.split(","):
        tables.append(evaluate(name.strip(), data, folder))
        typer.echo(tables[-1])
    if write is not None:
        write_between(write, MARK, "\n".join(tables))


if __name__ == "__main__":
    typer.run(main)
