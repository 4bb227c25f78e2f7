"""Train the reader on synthetic people: ``python -m models.training.reader --data SHARDS --out RUN [--minutes 60]``.

    python -m models.people --count 10000 --out SHARDS         # the data, see docs/synthetic-people.md
    python -m models.training.reader --data SHARDS --out RUN --minutes 600 [--shipped]

The run goes on from its checkpoint. ``log.jsonl`` gets a line for each measurement on held-out people: the shards whose
first seed is below ``HELD_OUT_BELOW`` are never trained on.
"""

from __future__ import annotations

import argparse
import copy
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from models.networks.reader import CHART_MM, PARTS, READER_SIZES, Read, Reader, ReaderSize, flops
from models.training.people_run import PeopleRun, batches
from models.training.reader_data import Batch, ReaderCrops, batch_of, read_cells, shard_seed
from service.face.reading import part_labels as labels
from service.runtime.sessions import MODELS

HELD_OUT_BELOW = 2048
"""Seeds of people that are never trained on."""
RATE, DECAY = 2e-3, 0.01
WARM_UP_STEPS = 100
WEIGHTS = {"chart": 1.0, "normal": 1.0, "parts": 2.0}
RARE = 0.4
"""Power of a part's share by which its pixels count less."""
SHARES = (0.36, 0.38, 0.004, 0.006, 0.012, 0.002, 0.001, 0.0015, 0.10, 0.01, 0.012, 0.09, 0.025)
"""Share of the pixels that each part has (``python -m models.people --statistics 200``)."""


def losses(read: Read, batch: Batch) -> dict[str, Tensor]:
    """Negative log-likelihoods: of the chart (mm, two axes), of the normal (three components), of the parts."""
    scale = torch.tensor(CHART_MM, device=read.chart.device).view(1, 2, 1, 1)
    off = ((read.chart - batch.chart) * scale).square().sum(1, keepdim=True)
    # Gaussian near, less steep far away: one wrong island must not outweigh a face.
    chart = 2.0 * read.chart_mm.log() + torch.log1p(off / (8.0 * read.chart_mm.square())) * 4.0
    turn = (read.normal - batch.normal).square().sum(1, keepdim=True)
    normal = 3.0 * read.normal_sine.log() + turn / (2.0 * read.normal_sine.square())
    weight = torch.tensor(SHARES, device=read.parts.device).pow(-RARE)
    weight = weight / (weight * torch.tensor(SHARES, device=weight.device)).sum()
    cross = -(functional.log_softmax(read.parts, 1) * batch.parts * weight.view(1, PARTS, 1, 1)).sum(1, keepdim=True)
    return {
        "chart": _mean(chart, batch.charted), "normal": _mean(normal, batch.shaped), "parts": _mean(cross, batch.known),
    }  # fmt: skip


def _mean(values: Tensor, where: Tensor) -> Tensor:
    return (values * where).sum() / where.sum().clamp(min=1.0)


class Measures:
    """Sums over held-out batches."""

    def __init__(self) -> None:
        self.millimetres: list[Tensor] = []
        self.degrees: list[Tensor] = []
        self.within: list[Tensor] = []
        self.both, self.either = torch.zeros(PARTS), torch.zeros(PARTS)

    def add(self, read: Read, batch: Batch) -> None:
        """Take in a batch."""
        charted, shaped = batch.charted[:, 0] > 0, batch.shaped[:, 0] > 0
        scale = torch.tensor(CHART_MM).view(1, 2, 1, 1)
        off = ((read.chart - batch.chart) * scale).square().sum(1).sqrt()[charted]
        self.millimetres.append(off)
        self.within.append((off < read.chart_mm[:, 0][charted]).float())
        cosine = (read.normal * batch.normal).sum(1)[shaped].clamp(-1.0, 1.0)
        self.degrees.append(torch.rad2deg(torch.acos(cosine)))
        said, true = read.parts.argmax(1), batch.parts.argmax(1)
        for k in range(PARTS):
            self.both[k] += ((said == k) & (true == k)).sum()
            self.either[k] += ((said == k) | (true == k)).sum()

    def numbers(self) -> dict[str, float]:
        """Chart error (mm along the face), error of normals (degrees), agreement of parts (intersection over union)."""
        off, turn, within = torch.cat(self.millimetres), torch.cat(self.degrees), torch.cat(self.within)
        overlap = self.both / self.either.clamp(min=1.0)
        result = {
            "chart_mm_median": float(off.median()), "chart_mm_mean": float(off.mean()),
            "within_one_sigma": float(within.mean()), "normal_deg_mean": float(turn.mean()),
            "normal_deg_median": float(turn.median()), "overlap_mean": float(overlap[self.either > 0].mean()),
        }  # fmt: skip
        shown = {f"overlap_{labels.PARTS[k]}": float(overlap[k]) for k in range(PARTS) if self.either[k] > 0}
        return {name: round(value, 4) for name, value in (result | shown).items()}


def measured_on(shards: list[Path], most: int) -> Iterator[Batch]:
    """Batches of at most ``most`` people in all."""
    for path in shards:
        cells = read_cells(path)
        for start in range(0, len(cells["seed"]), 16):
            if most <= 0:
                return
            index = np.arange(start, min(start + 16, len(cells["seed"]), start + most))
            most -= len(index)
            yield batch_of([(cells, int(i)) for i in index])


class Run(PeopleRun[Reader]):
    """A run of the reader.

    Raises:
        ModelFault: the checkpoint's network is of another size.
    """

    def __init__(self, folder: Path, device: str, seed: int = 0, size: ReaderSize | None = None) -> None:
        torch.manual_seed(seed)
        self.device = torch.device(device)
        network = Reader(size).to(self.device)
        optimiser = torch.optim.AdamW(network.parameters(), RATE, weight_decay=DECAY)
        super().__init__("reader", folder, network, optimiser, network.size)
        self.go_on(self.device)

    def train_step(self, batch: Batch, left: float, bf16: bool, rate: float = RATE) -> dict[str, float]:
        """One step; ``left`` is the share of the run's time that remains, ``rate`` its highest learning rate.

        Raises:
            ModelFault: the loss is not finite.
        """
        self.set_rate(rate * min((self.step + 1) / WARM_UP_STEPS, 1.0) * max(min(left / 0.4, 1.0), 0.02))
        batch = batch.to(self.device)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=bf16):
            read = self.network.read(batch.image)
        return self.descend(losses(read, batch), WEIGHTS)

    def measure(self, shards: list[Path], most: int) -> dict[str, float]:
        """The moving average on people that it has not seen."""
        measures = Measures()
        with torch.no_grad():
            for batch in measured_on(shards, most):
                read = self.average.read(batch.image.to(self.device))
                measures.add(Read(*(getattr(read, name).cpu() for name in Read.__dataclass_fields__)), batch)
        return measures.numbers()


def shards(data: Path, *, held_out: bool) -> list[Path]:
    """The shards of a folder, in the order of their seeds: those apart for measuring, or those to train on."""
    found = sorted(data.glob("people-*.npz"), key=shard_seed)
    return [path for path in found if (shard_seed(path) < HELD_OUT_BELOW) == held_out]


def train(
    run: Run, data: Path, minutes: float, batch: int, every: float, most: int, bf16: bool, steps: int = 0,
    sitting: float = np.inf, workers: int = 0, rate: float = RATE,
) -> None:  # fmt: skip
    """Train until the run has lasted ``minutes``, or for ``steps`` if given; measure every ``every`` minutes.

    At most ``sitting`` minutes now. ``workers`` processes make the batches, or this one does.
    """
    apart = shards(data, held_out=True)
    source = ReaderCrops(lambda: shards(data, held_out=False), batch, run.step)
    made: Iterator[Batch] = batches(source, workers)
    begun, before, saved = time.monotonic(), run.seconds, run.seconds
    sums: dict[str, float] = {}

    def done() -> float:
        """Share of the run that is over."""
        spent, length = (run.step, steps) if steps else (run.seconds, 60.0 * minutes)
        return spent / length if length > 0 else 1.0

    while done() < 1.0 and time.monotonic() - begun < 60 * sitting:
        for name, value in run.train_step(next(made), 1.0 - done(), bf16, rate).items():
            sums[name] = sums.get(name, value) * 0.98 + 0.02 * value
        run.seconds = before + time.monotonic() - begun
        if run.seconds - saved > 60.0 * every or done() >= 1.0:
            saved = run.seconds
            run.log({"step": run.step, "minutes": round(run.seconds / 60.0, 1),
                     **{f"loss_{name}": round(value, 4) for name, value in sums.items()},
                     **(run.measure(apart, most) if apart else {})})  # fmt: skip
            run.save()
    run.save()


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m models.training.reader",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--data", type=Path, required=True, help="folder of shards")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run")
    parser.add_argument("--minutes", type=float, default=60.0, help="length of the run, all its sittings together")
    parser.add_argument("--steps", type=int, default=0, help="length of the run in steps instead")
    parser.add_argument("--sitting", type=float, default=np.inf, help="minutes after which to stop for now")
    parser.add_argument("--workers", type=int, default=0, help="processes that make the batches; 0: this one")
    parser.add_argument("--size", choices=READER_SIZES, default="compact")
    parser.add_argument("--every", type=float, default=10.0, help="minutes between measurements")
    parser.add_argument("--most", type=int, default=256, help="held-out people to measure on")
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--rate", type=float, default=RATE, help="highest learning rate")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--shipped", action="store_true", help="a run that has not begun takes the service's weights")
    parser.add_argument("--threads", type=int, default=0, help="of torch; 0 leaves its own choice")
    parser.add_argument("--bf16", action="store_true", help="reckon in bfloat16, where the processor has it")
    chosen = parser.parse_args()
    if chosen.threads:
        torch.set_num_threads(chosen.threads)
    chosen.out.mkdir(parents=True, exist_ok=True)
    run = Run(chosen.out, chosen.device, size=READER_SIZES[chosen.size])
    if chosen.shipped and not run.step:
        run.take(MODELS / "reader.onnx")
    work = flops(copy.deepcopy(run.network).cpu()) / 1e9
    sys.stderr.write(f"reader: {work:.2f} GFLOP a crop, from step {run.step}\n")
    lengths = chosen.minutes, chosen.batch, chosen.every, chosen.most
    train(run, chosen.data, *lengths, chosen.bf16, chosen.steps, chosen.sitting, chosen.workers, chosen.rate)


if __name__ == "__main__":
    main()
