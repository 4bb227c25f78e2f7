"""The processes that train one network together, each started by torchrun; a single process is a team of one.

A step has a fixed number of *parts*, each a batch whose samples follow from seed, step and the part's number. The
members share the parts out, and add up their gradients. So the weights are the same, up to the rounding of the sums,
whatever the number of members, also where it changes on the way because a machine was lost. It is what
``DistributedDataParallel`` does, written out because a member may have several parts of a step, and zeta two
optimisers.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor, distributed, nn


@dataclass(frozen=True)
class Team:
    """One member's view of its team.

    Attributes:
        rank: of this member, from 0; the first one measures and writes the checkpoints.
        size: number of members.
        shared: whether torchrun started it, also where only one is left.
        device: where gradients are added up.
    """

    rank: int = 0
    size: int = 1
    shared: bool = False
    device: str = "cpu"

    @property
    def leads(self) -> bool:
        """Whether this member measures and saves."""
        return self.rank == 0

    def parts(self, count: int) -> range:
        """Numbers of this member's parts of a step that has ``count``."""
        return range(self.rank, count, self.size)

    def add_up(self, parameters: Iterable[nn.Parameter]) -> None:
        """Replace the gradients of each member by their sum over all members."""
        if self.size == 1:
            return
        gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
        total = torch.cat([gradient.flatten() for gradient in gradients])
        distributed.all_reduce(total)
        for gradient, part in zip(gradients, total.split([one.numel() for one in gradients]), strict=True):
            gradient.copy_(part.view(gradient.shape))

    def told(self, word: bool) -> bool:
        """What the first member says, for all; each calls it at the same point."""
        if self.size == 1:
            return word
        said = torch.tensor([int(word)], device=self.device)
        distributed.broadcast(said, 0)
        return bool(said.item())


@contextmanager
def joined(device: str) -> Iterator[tuple[Team, str]]:
    """The team that torchrun has started this process in, and the device of this member; else a team of one.

    Args:
        device: "cpu" or "cuda"; each member on a machine gets an accelerator of its own.
    """
    if "TORCHELASTIC_RUN_ID" not in os.environ:
        yield Team(), device
        return
    own = f"cuda:{os.environ['LOCAL_RANK']}" if device == "cuda" else device
    distributed.init_process_group("nccl" if device == "cuda" else "gloo")
    try:
        yield Team(distributed.get_rank(), distributed.get_world_size(), True, own), own
    finally:
        distributed.destroy_process_group()


def samples_of(seed: int, step: int, part: int) -> torch.Generator:
    """The generator that draws the samples of one part of a step; torch makes use of 32 bits of what it is given."""
    digest = hashlib.sha256(f"{seed} {step} {part}".encode()).digest()
    return torch.Generator(torch.get_default_device()).manual_seed(int.from_bytes(digest[:4], "big"))


def mean_of_parts(losses: list[dict[str, Tensor]]) -> dict[str, float]:
    """Means of named losses over a member's parts, as numbers."""
    return {name: float(torch.stack([one[name].detach() for one in losses]).mean()) for name in losses[0]}
