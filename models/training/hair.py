"""Train the hair reader: ``python -m models.training.hair --data SHARDS --out RUN``.

    python -m models.people --framing hair --start 100032 --count 6400 --out SHARDS     # see docs/synthetic-people.md
    python -m models.people --framing hair --count 256 --out SHARDS                     # held out
    python -m models.training.hair --data SHARDS --out RUN

A run begins with the body of the shipped reader, or with the shipped hair reader (``--shipped --rate 4e-4``), and goes
on from its checkpoint. ``log.jsonl`` gets a line for each measurement on held-out people, whose grooms are never
trained on.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from models.networks.hair import COUNTS, SIZES, HairReader, ReadHair
from models.networks.reader import ReaderSize
from models.people.shards import UNKNOWN
from models.training.hair_data import FIRST, HairBatch, HairCrops, People, batch_of, example, read_people
from models.training.people_run import CHECKPOINT, PeopleRun, batches
from models.training.reader import shards
from models.training.restore import weights_of
from service.hair.kinds import KINDS
from service.runtime.sessions import MODELS

RATE, DECAY = 1e-3, 0.02
WARM_UP_STEPS = 100
BODY_RATE = 0.4
"""Rate of what the reader knows already, over that of the new layers."""
WEIGHTS = {"mask": 4.0, "direction": 0.5, "kinds": 0.5, "ends": 0.1}
NOT_SHIPPED = "sharpness", "body.fields.", "body.parts."
"""What calibrates a run, made anew when it is exported, and the body's own outputs."""
AT_ONCE = 40
"""Shards in memory, of all workers together at least."""


def losses(read: ReadHair, batch: HairBatch) -> dict[str, Tensor]:
    """Of the mask: cross entropy and the overlap's complement; negative log-likelihoods of all else."""
    cross = functional.binary_cross_entropy_with_logits(read.mask, batch.mask, reduction="none")
    mask = (cross * batch.known).sum() / batch.known.sum().clamp(min=1)
    share = torch.sigmoid(read.mask) * batch.known
    truth = batch.mask * batch.known
    both, either = (share * truth).sum((1, 2, 3)), (share + truth - share * truth).sum((1, 2, 3))
    seen = (truth.sum((1, 2, 3)) > 20).float()
    overlap = ((1 - both / either.clamp(min=1)) * seen).sum() / seen.sum().clamp(min=1)
    off = (read.direction - batch.direction).square().sum(1, keepdim=True)
    way = 2 * read.spread.log() + off / (2 * read.spread.square())
    direction = (way * batch.strands).sum() / batch.strands.sum().clamp(min=1)
    kinds = torch.zeros((), device=batch.mask.device)
    for k, part in enumerate(read.kinds.split(COUNTS, 1)):
        told = batch.kinds[:, k] != UNKNOWN
        if told.any():
            kinds = kinds + functional.cross_entropy(part[told], batch.kinds[told, k], label_smoothing=0.02)
    known = torch.isfinite(batch.ends[:, 0])
    error = (read.ends[:, 0] - torch.nan_to_num(batch.ends[:, 0])) / read.ends[:, 1]
    ends = ((read.ends[:, 1].log() + 2 * torch.log1p(error.square() / 4)) * known).sum() / known.sum().clamp(min=1)
    return {"mask": mask + 0.25 * overlap, "direction": direction, "kinds": kinds, "ends": ends}


class Run(PeopleRun[HairReader]):
    """A run of the hair reader; ``bf16``: its convolutions in bfloat16, for processors that have it.

    Raises:
        ModelFault: the checkpoint's network is of another size.
    """

    def __init__(
        self, folder: Path, seed: int = 0, *, bf16: bool = False, device: str = "cpu", size: ReaderSize | None = None
    ) -> None:
        self.bf16, self.device = bf16, torch.device(device)
        torch.manual_seed(seed)
        network = HairReader(size)
        known = network.body.size == ReaderSize()
        if known and not (folder / CHECKPOINT).is_file():
            found = weights_of(MODELS / "reader.onnx")
            network.begin_with({name: found[name] for name in network.body.state_dict()})
        network = network.to(self.device)
        body = list(network.body.parameters())
        own = [p for name, p in network.named_parameters() if not name.startswith("body.")]
        groups = [{"params": body, "share": BODY_RATE if known else 1.0}, {"params": own, "share": 1.0}]
        optimiser = torch.optim.AdamW(groups, RATE, weight_decay=DECAY)
        super().__init__("hair", folder, network, optimiser, network.body.size)
        self.go_on(self.device)

    def train_step(self, batch: HairBatch, left: float, rate: float = RATE) -> dict[str, float]:
        """One step; ``left`` is the share of the run that remains, ``rate`` its highest learning rate.

        Raises:
            ModelFault: the loss is not finite.
        """
        self.set_rate(rate * min((self.step + 1) / WARM_UP_STEPS, 1.0) * max(min(left / 0.5, 1.0), 0.02))
        batch = batch.to(self.device)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.bf16):
            read = self.network.read(batch.image)
        return self.descend(losses(read, batch), WEIGHTS, most=0.995)


def measured(network: HairReader, apart: list[People], most: int) -> dict[str, float]:
    """What a network says of the first ``most`` held-out people."""
    overlap, degrees, off = [], [], []
    device = next(network.parameters()).device
    right: dict[str, list[float]] = {name: [] for name in KINDS}
    for people in apart:
        for first in range(0, min(len(people["seed"]), most), 16):
            index = range(first, min(first + 16, len(people["seed"]), most))
            batch = batch_of([example(people, i) for i in index]).to(device)
            with torch.no_grad():
                read = network.read(batch.image)
            said, true = read.mask[:, 0] > 0, batch.mask[:, 0] > 0.5
            for a, b in zip(said, true, strict=True):
                if b.sum() > 20:
                    overlap.append(float((a & b).sum() / (a | b).sum().clamp(min=1)))
            cosine = (read.direction * batch.direction).sum(1).clamp(-1, 1)[batch.strands[:, 0] > 0.5]
            degrees.append(torch.rad2deg(torch.acos(cosine)))
            for k, (name, part) in enumerate(zip(KINDS, read.kinds.split(COUNTS, 1), strict=True)):
                told = batch.kinds[:, k] != UNKNOWN
                right[name] += (part.argmax(1) == batch.kinds[:, k])[told].float().tolist()
            known = torch.isfinite(batch.ends[:, 0])
            off += (read.ends[:, 0] - batch.ends[:, 0])[known].abs().tolist()
        most -= len(people["seed"])
    result = {"overlap": np.mean(overlap), "direction_deg": float(torch.cat(degrees).mean()),
              "ends_mm": 1000 * np.median(off)}  # fmt: skip
    result |= {name: np.mean(values) for name, values in right.items()}
    return {name: round(float(value), 4) for name, value in result.items()}


def calibration_set(paths: list[Path]) -> HairBatch:
    """All people of some shards, as the service would cut them."""
    found = [read_people(path) for path in paths]
    return batch_of([example(people, i) for people in found for i in range(len(people["seed"]))])


def train(
    run: Run, data: Path, steps: int, sitting: float, batch: int, every: int, most: int, rate: float = RATE,
    seed: int = 0, workers: int = 0,
) -> None:  # fmt: skip
    """Train to ``steps``, at most ``sitting`` minutes now; measure every ``every`` steps. New shards are taken in.

    Args:
        run: of the network.
        data: folder of shards.
        steps: length of the run.
        sitting: minutes after which to stop for now.
        batch: crops of a step.
        every: steps between measurements.
        most: held-out people to measure on.
        rate: highest learning rate.
        seed: of all chance.
        workers: processes that cut the crops; 0: this one does.

    Raises:
        ModelFault: there is nothing to train on.
    """
    apart = [read_people(path) for path in shards(data, held_out=True)]
    at_once = AT_ONCE // max(workers, 1) + FIRST
    source = HairCrops(lambda: shards(data, held_out=False), batch, [seed, run.step], at_once)
    made: Iterator[HairBatch] = batches(source, workers)
    begun, before = time.monotonic(), run.seconds
    sums: dict[str, float] = {}
    while run.step < steps and time.monotonic() - begun < 60 * sitting:
        for name, value in run.train_step(next(made), 1 - run.step / steps, rate).items():
            sums[name] = sums.get(name, value) * 0.98 + 0.02 * value
        run.seconds = before + time.monotonic() - begun
        if run.step % every == 0 or run.step >= steps:
            run.save()
            run.log({"step": run.step, "minutes": round(run.seconds / 60, 1),
                     **{f"loss_{name}": round(value, 4) for name, value in sums.items()},
                     **(measured(run.average, apart, most) if apart else {})})  # fmt: skip
    run.save()


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m models.training.hair",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--data", type=Path, required=True, help="folder of shards")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run")
    parser.add_argument("--steps", type=int, default=6000, help="length of the run, all its sittings together")
    parser.add_argument("--sitting", type=float, default=1e9, help="minutes after which to stop for now")
    parser.add_argument("--every", type=int, default=250, help="steps between measurements")
    parser.add_argument("--most", type=int, default=128, help="held-out people to measure on")
    parser.add_argument("--batch", type=int, default=12)
    parser.add_argument("--rate", type=float, default=RATE, help="highest learning rate")
    parser.add_argument("--shipped", action="store_true", help="a run that has not begun takes the service's weights")
    parser.add_argument("--threads", type=int, default=0, help="of torch; 0 leaves its own choice")
    parser.add_argument("--bf16", action="store_true", help="bfloat16: 1.8 times as fast where the processor has it")
    parser.add_argument("--size", choices=SIZES, default="broad")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--workers", type=int, default=0, help="processes that cut the crops; 0: this one")
    chosen = parser.parse_args()
    if chosen.threads:
        torch.set_num_threads(chosen.threads)
    chosen.out.mkdir(parents=True, exist_ok=True)
    run = Run(chosen.out, bf16=chosen.bf16, device=chosen.device, size=SIZES[chosen.size])
    if chosen.shipped and not run.step:
        run.take(MODELS / "hair.onnx", NOT_SHIPPED)
    lengths = chosen.steps, chosen.sitting, chosen.batch, chosen.every, chosen.most
    train(run, chosen.data, *lengths, chosen.rate, workers=chosen.workers)


if __name__ == "__main__":
    main()
