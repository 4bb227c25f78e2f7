"""What runs of networks that learn from synthetic people share: a checkpoint, a step of the optimiser and a log."""

from __future__ import annotations

import copy
import dataclasses
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader, IterableDataset

from models.networks.reader import ReaderSize
from models.training.moving_average import MOST, follow
from models.training.restore import weights_for
from service.errors import ModelFault

N = TypeVar("N", bound=nn.Module)
B = TypeVar("B")

CHECKPOINT = "checkpoint.pt"


def batches(source: IterableDataset[B], workers: int) -> Iterator[B]:
    """The batches of a source, made by ``workers`` processes; 0: by this one."""
    return iter(DataLoader(source, None, num_workers=workers, prefetch_factor=4 if workers else None))


class PeopleRun(Generic[N]):
    """Network, moving average and optimiser of a run.

    Args:
        name: of the network, for faults.
        folder: of ``checkpoint.pt`` and ``log.jsonl``.
        network: on its device, as it begins.
        optimiser: of its parameters; groups with a ``share`` take that share of the rate.
        size: of its body.
    """

    def __init__(
        self, name: str, folder: Path, network: N, optimiser: torch.optim.Optimizer, size: ReaderSize
    ) -> None:
        self.name, self.folder, self.network, self.optimiser, self.size = name, folder, network, optimiser, size
        self.average = copy.deepcopy(network).eval().requires_grad_(False)
        self.step, self.seconds = 0, 0.0

    def go_on(self, device: torch.device) -> None:
        """Go on from the folder's checkpoint, where there is one.

        Raises:
            ModelFault: its network is of another size.
        """
        path = self.folder / CHECKPOINT
        if not path.is_file():
            return
        content = torch.load(path, map_location=device, weights_only=True)
        there = ReaderSize(**content.get("size", dataclasses.asdict(ReaderSize())))
        if there != self.size:
            raise ModelFault(f"{path} is a run of {there}, not of {self.size}: give its --size")
        for name in ("network", "average", "optimiser"):
            getattr(self, name).load_state_dict(content[name])
        self.step, self.seconds = content["step"], content["seconds"]

    def take(self, path: Path, apart: tuple[str, ...] = ()) -> None:
        """Begin with the weights of an ONNX file of the service; the optimiser begins afresh.

        Args:
            path: the file.
            apart: beginnings of the names of what does not ship, and stays as it is.

        Raises:
            ModelFault: there is no such file, or its network is of another size.
        """
        state = self.network.state_dict()
        state |= weights_for(state, path, apart)
        for network in (self.network, self.average):
            network.load_state_dict(state)

    def save(self) -> None:
        """Write the checkpoint, whole or not at all."""
        content = {
            "network": self.network.state_dict(), "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(), "step": self.step, "seconds": self.seconds,
            "size": dataclasses.asdict(self.size),
        }  # fmt: skip
        part = self.folder / "checkpoint.part"
        torch.save(content, part)
        part.replace(self.folder / CHECKPOINT)

    def set_rate(self, rate: float) -> None:
        """Learning rate of the next step."""
        for group in self.optimiser.param_groups:
            group["lr"] = rate * group.get("share", 1.0)

    def descend(self, parts: dict[str, Tensor], weights: dict[str, float], most: float = MOST) -> dict[str, float]:
        """One step along the weighed sum of the losses; the moving average keeps at most the share ``most``.

        Raises:
            ModelFault: the loss is not finite.
        """
        total = torch.stack([weights[name] * value for name, value in parts.items()]).sum()
        if not torch.isfinite(total):
            raise ModelFault(f"{self.name}: the loss is {float(total)} at step {self.step}")
        self.optimiser.zero_grad(set_to_none=True)
        total.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        self.optimiser.step()
        follow(self.average, self.network, self.step, most)
        self.step += 1
        return {name: float(value.detach()) for name, value in parts.items()}

    def log(self, line: dict[str, Any]) -> None:
        """A line of measurements, to the log and to stderr."""
        with (self.folder / "log.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        sys.stderr.write(json.dumps(line) + "\n")
