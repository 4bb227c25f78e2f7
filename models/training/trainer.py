"""One training run: a network, its moving average, its optimiser, and the checkpoints that it goes on from."""

from __future__ import annotations

import copy
from collections import defaultdict
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn

from models.networks.configs import build
from models.networks.discriminator import Discriminator, fool_loss, judge_loss, matching_loss
from models.training.moving_average import follow
from models.training.super_resolution import ZetaTask
from models.training.tasks import Batch, Task
from models.training.team import Team, mean_of_parts, samples_of
from service.errors import ModelFault


@dataclass(frozen=True)
class Run:
    """Settings of a run, kept in its checkpoints; each of the ``parts`` of a step has ``batch`` samples."""

    network: str
    config: str
    steps: int
    batch: int
    side: int
    rate: float
    seed: int
    adversarial_from: float
    adversarial_weight: float
    parts: int = 1


def widened(value: Tensor, shape: torch.Size) -> Tensor:
    """A kernel (out, in, h, w) with 0 for the inputs that ``shape`` has beyond its own; any other tensor as it is."""
    if value.dim() != 4 or len(shape) != 4 or value.shape[1] >= shape[1]:
        return value
    new = value.new_zeros(value.shape[0], shape[1] - value.shape[1], *value.shape[2:])
    return torch.cat([value, new], 1)


class Trainer:
    """A network, its moving average and everything that a run needs to go on.

    Args:
        run: its settings.
        task: what the network learns.
        device: of torch.
        bf16: compute in half precision, as it does on an accelerator anyway.
        team: the processes that train it.
    """

    def __init__(self, run: Run, task: Task, device: str, bf16: bool = False, team: Team | None = None) -> None:
        torch.manual_seed(run.seed)
        self.run, self.task, self.device = run, task, torch.device(device)
        self.team = team or Team()
        self.bf16 = bf16 or self.device.type == "cuda"
        # Group normalisation, which the context alone has, is slow with channels last.
        order = torch.contiguous_format if run.network == "delta_context" else torch.channels_last
        self.network = build(run.network, run.config).to(self.device, memory_format=order)
        self.average = copy.deepcopy(self.network).eval().requires_grad_(False)
        self.optimiser = torch.optim.Adam(self.network.parameters(), run.rate, betas=(0.9, 0.99))
        self.generator = torch.Generator(torch.get_default_device()).manual_seed(run.seed)
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
        batches = self._batches()
        results = [self._result(batch) for batch in batches]
        losses = [{"plain": self.task.loss(result, batch)} for result, batch in zip(results, batches, strict=True)]
        if self.judge is not None and self.step >= self.run.adversarial_from * self.run.steps:
            judged = self._judged(self.judge, batches, results)
            losses = [loss | more for loss, more in zip(losses, judged, strict=True)]
        self.optimiser.zero_grad(set_to_none=True)
        for loss in losses:
            total = cast(Tensor, sum(loss.values())) / self.run.parts
            if not torch.isfinite(total):
                raise ModelFault(f"{self.run.network}: the loss is {float(total)} at step {self.step}")
            total.backward()
        self.team.add_up(self.network.parameters())
        nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        self.optimiser.step()
        follow(self.average, self.network, self.step)
        self.step += 1
        return mean_of_parts(losses)

    def _batches(self) -> list[Batch]:
        """What this member of the team has to do in this step; alone it draws from one stream of random numbers."""
        if not self.team.shared:
            return [self._to_device(self.task.batch(self.run.batch, self.generator)) for _ in range(self.run.parts)]
        drawn = (samples_of(self.run.seed, self.step, part) for part in self.team.parts(self.run.parts))
        return [self._to_device(self.task.batch(self.run.batch, generator)) for generator in drawn]

    def _result(self, batch: Batch) -> Tensor:
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.bf16):
            return self.task.predict(self.network, batch).float()

    def _judged(self, judge: Discriminator, batches: list[Batch], results: list[Tensor]) -> list[dict[str, Tensor]]:
        """Train the discriminator; what it then says of each part of the step."""
        task, optimiser = cast(ZetaTask, self.task), cast(torch.optim.Optimizer, self.judge_optimiser)
        real = [task.judged(batch, batch["large"]) for batch in batches]
        fake = [task.judged(batch, result) for batch, result in zip(batches, results, strict=True)]
        optimiser.zero_grad(set_to_none=True)
        for seen, made in zip(real, fake, strict=True):
            (judge_loss(judge(seen), judge(made.detach())) / self.run.parts).backward()
        self.team.add_up(judge.parameters())
        optimiser.step()
        judge.requires_grad_(False)
        said = [(judge(seen), judge(made)) for seen, made in zip(real, fake, strict=True)]
        judge.requires_grad_(True)
        weight = self.run.adversarial_weight
        return [
            {"fool": weight * fool_loss(made), "matching": 10.0 * weight * matching_loss(seen, made)}
            for seen, made in said
        ]

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
        self.run = replace(self.run, parts=content["run"].get("parts", 1))
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

        Kernels whose last inputs are new have those at 0.

        Raises:
            ModelFault: it belongs to another network.
        """
        content = torch.load(folder / "checkpoint.pt", map_location=self.device, weights_only=True)
        if content["run"]["network"] != self.run.network:
            raise ModelFault(f"{folder}: the checkpoint is of {content['run']['network']!r}, not {self.run.network!r}")
        own = self.network.state_dict()
        fitting = {name: widened(value, own[name].shape) for name, value in content["average"].items() if name in own}
        fitting = {name: value for name, value in fitting.items() if own[name].shape == value.shape}
        self.take(own | fitting)
        if self.judge is not None and "judge" in content:
            self.judge.load_state_dict(content["judge"])
        return sorted(set(own) - set(fitting))

    def _to_device(self, batch: Batch) -> Batch:
        return {name: value.to(self.device) for name, value in batch.items()}
