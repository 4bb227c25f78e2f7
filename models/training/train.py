"""Trains one network: ``python -m models.training.train rho --data DIR --steps 4000``.

A run writes into its folder: ``checkpoint.pt`` (weights, their moving average, optimiser, random state, step, and the
run's settings: started again with the same folder, it goes on), ``log.jsonl`` (a line per measurement on held-out
subjects), ``sheet.png`` (held-out results beside the truth).
"""

from __future__ import annotations

import copy
import json
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, cast

import cv2
import numpy as np
import torch
import typer
from torch import Tensor, nn

from models.networks.configs import NETWORKS, build, parameters
from models.networks.discriminator import Discriminator, fool_loss, judge_loss, matching_loss
from models.networks.stages import DeltaBlind
from models.training.albedo import DeltaTask
from models.training.context import ContextTask
from models.training.normals import NormalTask
from models.training.specular_albedo import PsiTask
from models.training.super_resolution import ZetaTask
from models.training.tasks import Batch, Task
from service.errors import ModelFault, UsageError

TASKS: dict[str, Callable[[Path, int], Task]] = {
    "delta_context": lambda data, _: ContextTask(data),
    "delta": lambda data, side: DeltaTask(data, side),
    "delta_blind": lambda data, side: DeltaTask(data, side, DeltaBlind.channels),
    "psi": lambda data, side: PsiTask(data, side),
    "rho": lambda data, side: NormalTask(data, "specular_normal", side),
    "sigma": lambda data, side: NormalTask(data, "diffuse_normal", side),
    "zeta": lambda data, side: ZetaTask(data, max(side // 8, 16)),
}


@dataclass(frozen=True)
class Run:
    """Settings of a run, kept in its checkpoints."""

    network: str
    config: str
    steps: int
    batch: int
    side: int
    rate: float
    seed: int
    adversarial_from: float
    adversarial_weight: float


class Trainer:
    """A network, its moving average and everything that a run needs to go on."""

    def __init__(self, run: Run, task: Task, device: str, bf16: bool = False) -> None:
        torch.manual_seed(run.seed)
        self.run, self.task, self.device = run, task, torch.device(device)
        self.bf16 = bf16 or self.device.type == "cuda"
        # Group normalisation, which the context alone has, is slow with channels last.
        order = torch.contiguous_format if run.network == "delta_context" else torch.channels_last
        self.network = build(run.network, run.config).to(self.device, memory_format=order)
        self.average = copy.deepcopy(self.network).eval().requires_grad_(False)
        self.optimiser = torch.optim.Adam(self.network.parameters(), run.rate, betas=(0.9, 0.99))
        self.generator = torch.Generator().manual_seed(run.seed)
        self.judge: Discriminator | None = None
        self.judge_optimiser: torch.optim.Optimizer | None = None
        if run.adversarial_weight > 0.0:
            self.judge = Discriminator(6, 24).to(self.device)
            self.judge_optimiser = torch.optim.Adam(self.judge.parameters(), 2e-4, betas=(0.5, 0.999))
        self.step, self.seconds = 0, 0.0

    def rate(self) -> float:
        """Short warm-up, flat, then down to a twentieth over the last 40 %."""
        done = self.step / max(self.run.steps, 1)
        rise = min((self.step + 1) / 100.0, 1.0)
        return self.run.rate * rise * (1.0 if done < 0.6 else 1.0 - 0.95 * (done - 0.6) / 0.4)

    def train_step(self) -> dict[str, float]:
        """One step; the parts of the loss.

        Raises:
            ModelFault: the loss is not finite.
        """
        for group in self.optimiser.param_groups:
            group["lr"] = self.rate()
        batch = self._to_device(self.task.batch(self.run.batch, self.generator))
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.bf16):
            result = self.task.predict(self.network, batch)
        result = result.float()
        parts = {"plain": self.task.loss(result, batch)}
        if self.judge is not None and self.step >= self.run.adversarial_from * self.run.steps:
            parts.update(self._adversarial(cast(ZetaTask, self.task), result, batch))
        total = cast(Tensor, sum(parts.values()))
        if not torch.isfinite(total):
            raise ModelFault(f"{self.run.network}: the loss is {float(total)} at step {self.step}")
        self.optimiser.zero_grad(set_to_none=True)
        total.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        self.optimiser.step()
        decay = min(0.999, (1.0 + self.step) / (10.0 + self.step))
        with torch.no_grad():
            for slow, fast in zip(self.average.parameters(), self.network.parameters(), strict=True):
                slow.lerp_(fast, 1.0 - decay)
        self.step += 1
        return {name: float(value.detach()) for name, value in parts.items()}

    def _adversarial(self, task: ZetaTask, result: Tensor, batch: Batch) -> dict[str, Tensor]:
        if self.judge is None or self.judge_optimiser is None:
            return {}
        real, fake = task.judged(batch, batch["large"]), task.judged(batch, result)
        loss = judge_loss(self.judge(real), self.judge(fake.detach()))
        self.judge_optimiser.zero_grad(set_to_none=True)
        loss.backward()
        self.judge_optimiser.step()
        self.judge.requires_grad_(False)
        seen, made = self.judge(real), self.judge(fake)
        self.judge.requires_grad_(True)
        weight = self.run.adversarial_weight
        return {"fool": weight * fool_loss(made), "matching": 10.0 * weight * matching_loss(seen, made)}

    def measure(self) -> tuple[dict[str, float], Tensor]:
        """Mean numbers of the moving average on held-out subjects, and a picture of the first results."""
        sums: dict[str, list[float]] = defaultdict(list)
        sheet = torch.zeros(3, 8, 8)
        with torch.no_grad():
            for i, batch in enumerate(self.task.held_out()):
                batch = self._to_device(batch)
                result = self.task.predict(self.average, batch)
                for name, value in self.task.measure(result, batch).items():
                    sums[name].append(value)
                if i == 0:
                    sheet = self.task.sheet(result, batch).cpu()
        return {name: round(float(np.mean(values)), 4) for name, values in sums.items()}, sheet

    def save(self, folder: Path) -> None:
        """Write the checkpoint, whole or not at all."""
        content: dict[str, Any] = {
            "run": asdict(self.run), "step": self.step, "seconds": self.seconds,
            "network": self.network.state_dict(), "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(), "random": self.generator.get_state(),
        }  # fmt: skip
        if self.judge is not None and self.judge_optimiser is not None:
            content |= {"judge": self.judge.state_dict(), "judge_optimiser": self.judge_optimiser.state_dict()}
        unfinished = folder / "checkpoint.part"
        torch.save(content, unfinished)
        unfinished.replace(folder / "checkpoint.pt")

    def load(self, folder: Path) -> None:
        """Go on from a checkpoint.

        Raises:
            ModelFault: it belongs to another network or configuration.
        """
        content = torch.load(folder / "checkpoint.pt", map_location=self.device, weights_only=True)
        for name in ("network", "config"):
            if content["run"][name] != getattr(self.run, name):
                found = content["run"][name]
                raise ModelFault(f"{folder}: the checkpoint is of {name} {found!r}, not {getattr(self.run, name)!r}")
        self.step, self.seconds = content["step"], content["seconds"]
        self.network.load_state_dict(content["network"])
        self.average.load_state_dict(content["average"])
        self.optimiser.load_state_dict(content["optimiser"])
        self.generator.set_state(content["random"].cpu())
        if self.judge is not None and self.judge_optimiser is not None and "judge" in content:
            self.judge.load_state_dict(content["judge"])
            self.judge_optimiser.load_state_dict(content["judge_optimiser"])

    def take(self, state: dict[str, Tensor]) -> None:
        """Set the weights, and their moving average, to ``state``."""
        for network in (self.network, self.average):
            network.load_state_dict(state)

    def begin_with(self, folder: Path) -> list[str]:
        """Take the averaged weights of another run for a first state; names of the parts that it lacks.

        Raises:
            ModelFault: it belongs to another network.
        """
        content = torch.load(folder / "checkpoint.pt", map_location=self.device, weights_only=True)
        if content["run"]["network"] != self.run.network:
            raise ModelFault(f"{folder}: the checkpoint is of {content['run']['network']!r}, not {self.run.network!r}")
        own = self.network.state_dict()
        fitting = {name: value for name, value in content["average"].items()
                   if name in own and own[name].shape == value.shape}  # fmt: skip
        self.take(own | fitting)
        if self.judge is not None and "judge" in content:
            self.judge.load_state_dict(content["judge"])
        return sorted(set(own) - set(fitting))

    def _to_device(self, batch: Batch) -> Batch:
        return {name: value.to(self.device) for name, value in batch.items()}


def write_sheet(sheet: Tensor, path: Path) -> None:
    """(3, h, w) in [0, 1] -> PNG."""
    image = (sheet.clamp(0.0, 1.0) * 255.0).byte().permute(1, 2, 0).numpy()[..., ::-1]
    cv2.imwrite(str(path), np.ascontiguousarray(image))


def go(trainer: Trainer, folder: Path, every: int, minutes: float) -> None:
    """Train until the steps are done or the time is up, measuring now and then."""
    run, begin, before = trainer.run, time.perf_counter(), trainer.seconds
    losses: dict[str, list[float]] = defaultdict(list)
    while trainer.step < run.steps:
        for name, value in trainer.train_step().items():
            losses[name].append(value)
        trainer.seconds = before + time.perf_counter() - begin
        late = (time.perf_counter() - begin) > 60.0 * minutes
        if trainer.step % every and not late and trainer.step < run.steps:
            continue
        numbers, sheet = trainer.measure()
        line = {
            "step": trainer.step, "seconds": round(trainer.seconds), "rate": trainer.rate(),
            "loss": {name: round(float(np.mean(values)), 5) for name, values in losses.items()}, "held_out": numbers,
        }  # fmt: skip
        losses.clear()
        with (folder / "log.jsonl").open("a", encoding="utf-8") as log:
            log.write(json.dumps(line) + "\n")
        typer.echo(json.dumps(line))
        write_sheet(sheet, folder / "sheet.png")
        trainer.save(folder)
        trainer.task.refresh()
        if late:
            break


def main(
    network: Annotated[str, typer.Argument(help=f"One of: {', '.join(NETWORKS)}.")],
    data: Annotated[Path, typer.Option(help="Folder of captures.")],
    config: Annotated[str, typer.Option(help="slim, compact, wide or paper.")] = "compact",
    output: Annotated[Path | None, typer.Option("-o", help="Folder of the run.")] = None,
    steps: Annotated[int, typer.Option(min=1)] = 4000,
    batch: Annotated[int, typer.Option(min=1)] = 8,
    side: Annotated[int, typer.Option(min=64, help="Of a training crop, texels.")] = 256,
    rate: Annotated[float, typer.Option(help="Adam's learning rate.")] = 4e-4,
    seed: int = 1,
    every: Annotated[int, typer.Option(min=1, help="Steps between measurements and checkpoints.")] = 200,
    minutes: Annotated[float, typer.Option(help="Stop after this time; start again to go on.")] = 1e9,
    adversarial_from: Annotated[float, typer.Option(min=0.0, max=1.0, help="Share of the steps without it.")] = 0.6,
    adversarial_weight: Annotated[float, typer.Option(min=0.0, help="0 trains without a discriminator.")] = 0.0,
    begin_with: Annotated[Path | None, typer.Option(help="Run whose weights a new one begins with.")] = None,
    threads: Annotated[int, typer.Option(min=1)] = 1,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    bf16: Annotated[bool, typer.Option(help="Half precision: faster on a CPU with AVX-512 BF16 or AMX.")] = False,
) -> None:
    """Train a network, or go on with its training."""
    if network not in TASKS:
        raise UsageError(f"network is {network!r}; there are {', '.join(TASKS)}")
    if adversarial_weight > 0.0 and network != "zeta":
        raise UsageError("adversarial_weight is for zeta; the other networks have one right answer")
    torch.set_num_threads(threads)
    folder = output or Path("build/training") / f"{network}_{config}"
    folder.mkdir(parents=True, exist_ok=True)
    task = TASKS[network](data, side)
    task.refresh()
    run = Run(network, config, steps, batch, side, rate, seed, adversarial_from, adversarial_weight)
    trainer = Trainer(run, task, device, bf16)
    if (folder / "checkpoint.pt").exists():
        trainer.load(folder)
    elif begin_with is not None:
        fresh = trainer.begin_with(begin_with)
        typer.echo(f"begins with {begin_with}; fresh: {', '.join(fresh) or 'nothing'}")
    typer.echo(f"{network} {config}: {parameters(trainer.network)} parameters, step {trainer.step} of {steps}")
    go(trainer, folder, every, minutes)


if __name__ == "__main__":
    typer.run(main)
