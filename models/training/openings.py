"""Train the networks of lids and lips: ``python -m models.training.openings --data SHARDS --out RUN``.

    python -m models.people --count 6000 --out SHARDS
    python -m models.training.openings --data SHARDS --out RUN [--minutes 10] [--kind lids]

They learn from synthetic people. The truth is where the camera sees the edges of the head's own lids and lips. In half
of the open mouths teeth are painted whiter, or fill all of the opening as in a broad smile: synthetic ones are greyer,
a dark gap lies beneath them, and what was learnt from that took bright teeth for the lower lip. The run begins afresh
each time (it is a matter of minutes) or with the weights of the service (``--shipped``), ends with ``lids.pt`` and
``lips.pt``, and prints the error on held-out people: of the opening in the middle, millimetres, taking an eye to be
30 mm long and a mouth 50; and with teeth painted on them (``white_``).
"""

from __future__ import annotations

import argparse
import copy
import json
import math
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional

from models.networks.openings import OpeningNetwork, loss
from models.people.make import Portrait
from models.people.shards import decode, load
from models.training.moving_average import follow
from models.training.reader import shards
from models.training.restore import weights_of
from service.errors import ModelFault
from service.face.reading import openings
from service.face.reading.openings import KINDS, OpeningKind
from service.face.reading.part_labels import MOUTH
from service.head.files import load_head
from service.head.model import HeadModel
from service.head.regions import OpeningEdges, lid_edges, lip_edges
from service.runtime.sessions import MODELS

RATE, BATCH = 2e-3, 64
LENGTH_MM = {"lids": 30.0, "lips": 50.0}
JITTER = 0.08
"""Scatter of the corners that a landmark network finds, over the distance between them; half of it upwards."""

TIMES = 4
"""Patches of each opening."""
LEAST_PX = 7.0
"""Least distance of the corners."""

WHITENED, FILLED = 0.5, 0.5
"""Share of the patches whose teeth are whiter, and of these with teeth in all of the opening."""

Float = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Sample:
    """An opening in a portrait.

    Attributes:
        image: index of the portrait; name: of the opening.
        corners: (2, 2) pixels; upper, lower: (N, 2) pixels of each row of an edge.
    """

    image: int
    name: str
    corners: Float
    upper: list[Float]
    lower: list[Float]


def edges_of(head: HeadModel, name: str) -> OpeningEdges:
    """Rows of an opening of our head."""
    found = lip_edges(head) if name == "mouth" else lid_edges(head, name)
    if found is None:
        raise ValueError(f"the head has no edges of {name}")
    return found


def gather(paths: list[Path], kind: OpeningKind, head: HeadModel) -> tuple[list[Picture], list[Picture], list[Sample]]:
    """Pictures, where they show the inside of a mouth, and all openings of a kind whose corners the camera may see."""
    images: list[Picture] = []
    mouths: list[Picture] = []
    samples: list[Sample] = []
    edges = {name: edges_of(head, name) for name in kind.corners}
    for path in paths:
        for person in decode(load(path)):
            images.append(person.image)
            mouths.append(np.repeat(np.uint8(255) * (person.part == MOUTH)[..., None], 3, 2).astype(np.uint8))
            for name, pair in kind.corners.items():
                corners = person.points[list(pair)].astype(np.float64)
                across = corners[1] - corners[0]
                if np.isfinite(corners).all() and across[0] > 0 and np.hypot(*across) > LEAST_PX:
                    upper, lower = (_seen(person, rows) for rows in (edges[name].upper, edges[name].lower))
                    samples.append(Sample(len(images) - 1, name, corners, upper, lower))
    return images, mouths, samples


def _seen(person: Portrait, rows: tuple[npt.NDArray[np.int64], ...]) -> list[Float]:
    """Rows of vertices in the portrait's pixels."""
    return [person.camera.project(person.vertices[row].astype(np.float64)) for row in rows]


def heights(sample: Sample, left: Float, right: Float) -> Float:
    """(2, 9) heights of upper and lower edge over the distance of two corners, at the stations between them."""
    across = right - left
    square = float(across @ across)
    up = np.array([across[1], -across[0]])
    out = []
    for rows, bounding in ((sample.upper, np.min), (sample.lower, np.max)):
        curves = []
        for row in rows:
            offset = row - left
            place, height = offset @ across / square, offset @ up / square
            order = np.argsort(place)
            curves.append(np.interp(openings.STATIONS, place[order], height[order]))
        out.append(bounding(np.array(curves), 0))
    upper, lower = out
    closed = upper < lower  # one lid lies before the other
    middle = (upper + lower) / 2
    return np.stack([np.where(closed, middle, upper), np.where(closed, middle, lower)])


@dataclass
class Patches:
    """Patches of N openings with their truth.

    Attributes:
        image: (N, 3, S, S) uint8; mouth: (N, 1, S, S) uint8, 255 inside of the mouth.
        truth: (N, 2, 9) heights over the length, of the upper and the lower edge.
    """

    image: Tensor
    mouth: Tensor
    truth: Tensor


def cut(
    kind: OpeningKind, images: list[Picture], mouths: list[Picture], samples: list[Sample], times: int, jitter: float,
    random: np.random.Generator,
) -> Patches:  # fmt: skip
    """Each opening so many times, its corners shaken as a landmark network shakes them."""
    patches, insides, truths = [], [], []
    for sample in samples:
        length = float(np.hypot(*(sample.corners[1] - sample.corners[0])))
        for _ in range(times):
            off = random.normal(0.0, jitter * length, (2, 2)) * [1.0, 0.5]
            left, right = sample.corners + off
            region = kind.region(left, right)
            if region is None:
                continue
            patch, inside = (region.cut(pictures[sample.image], kind.side) for pictures in (images, mouths))
            truth = heights(sample, left, right)
            if sample.name in kind.flipped or (not kind.flipped and times > 1 and random.random() < 0.5):
                patch, inside, truth = patch[:, ::-1], inside[:, ::-1], truth[:, ::-1]
            patches.append(np.ascontiguousarray(patch.transpose(2, 0, 1)))
            insides.append(np.ascontiguousarray(inside.transpose(2, 0, 1)[:1]))
            truths.append(truth)
    return Patches(
        torch.from_numpy(np.stack(patches)), torch.from_numpy(np.stack(insides)),
        torch.from_numpy(np.stack(truths)).float(),
    )  # fmt: skip


def whitened(image: Tensor, mouth: Tensor, generator: torch.Generator) -> Tensor:
    """(N, 3, S, S) uint8 patches, in some whiter teeth, which in some fill the mouth (N, 1, S, S) uint8."""
    count, side = len(image), image.shape[-1]

    def draw(low: float, high: float, channels: int = 1) -> Tensor:
        return low + (high - low) * torch.rand(count, channels, 1, 1, generator=generator)

    value, inside = image.float() / 255, mouth.float() / 255
    teeth = ((value.mean(1, keepdim=True) - draw(0.1, 0.3)) / 0.2).clamp(0, 1)
    teeth = torch.where(draw(0, 1) < FILLED, torch.ones_like(teeth), teeth)
    place = (torch.arange(side) + side * draw(0, 1)) / draw(3.0, 7.0)  # gaps between teeth, in patch pixels
    gaps = 1 - draw(0, 0.35) * torch.exp(-(((place % 1) - 0.5) / 0.12).square())
    around = value.flatten(2).quantile(0.8, dim=2)[..., None, None]  # as bright as the skin or brighter
    white = (around.mean(1, keepdim=True) * draw(0.9, 1.4) * draw(0.93, 1.05, 3)).clamp(max=1) * gaps
    here = inside * teeth * (draw(0, 1) < WHITENED)
    return ((value + here * (white - value)).clamp(0, 1) * 255).round().byte()


def graded(image: Tensor, generator: torch.Generator) -> Tensor:
    """(N, 3, S, S) uint8 -> float in [0, 1]: other light, sharper or softer, grey, noisy."""
    count = len(image)

    def draw(low: float, high: float, channels: int = 1) -> Tensor:
        return low + (high - low) * torch.rand(count, channels, 1, 1, generator=generator)

    value = image.float() / 255
    soft = functional.avg_pool2d(value, 3, 1, 1, count_include_pad=False)
    value = value + draw(-0.9, 1.6) * (draw(0, 1) < 0.7) * (value - soft)
    value = (value - 0.5) * draw(0.7, 1.35) + 0.5 + draw(-0.1, 0.1)
    value = value * draw(0.85, 1.15, 3)
    value = torch.where(draw(0, 1) < 0.15, value.mean(1, keepdim=True), value)
    value = value + torch.randn(value.shape, generator=generator) * draw(0, 0.03)
    return value.clamp(0, 1)


def measure(network: OpeningNetwork, apart: Patches, kind: OpeningKind) -> dict[str, float]:
    """Errors on held-out patches."""
    with torch.no_grad():
        answers = [network(part.float() / 255) for part in apart.image.split(256)]
    h, s = (torch.cat([answer[k] for answer in answers]) for k in (0, 1))
    t, unit = apart.truth, LENGTH_MM[kind.name]
    gaps = [(x[:, 0] - x[:, 1])[:, 2:7].amax(1).clamp(min=0) * unit for x in (h, t)]
    off, shut = (gaps[0] - gaps[1]).abs(), gaps[1] < 1.0
    sure = s.flatten(1).median(1).values < openings.UNSURE
    return {
        "edges_mm": float((h - t).abs().mean() * unit), "opening_mm": float(off.mean()),
        "opening_mm_where_sure": float(off[sure].mean()), "sure": float(sure.float().mean()),
        "closed_mm": float(off[shut & sure].mean()), "within_sigma": float(((h - t).abs() < s).float().mean()),
    }  # fmt: skip


def train(
    kind: OpeningKind, data: Path, out: Path, minutes: float, seed: int = 0, *, shipped: bool = False
) -> dict[str, float]:
    """Train one kind for so many minutes, from the weights of the service if they are asked for, and save it."""
    torch.manual_seed(seed)
    head, random = load_head(), np.random.default_rng(seed)
    taught = cut(kind, *gather(shards(data, held_out=False), kind, head), TIMES, JITTER, random)
    apart = cut(kind, *gather(shards(data, held_out=True), kind, head), 1, 0.4 * JITTER, random)
    network, rate = OpeningNetwork(kind.side), RATE
    if shipped:
        rate = RATE / 4
        network.load_state_dict(weights_of(MODELS / f"{kind.name}.onnx"))
    average = copy.deepcopy(network).eval().requires_grad_(False)
    optimiser = torch.optim.AdamW(network.parameters(), RATE, weight_decay=0.02)
    sys.stderr.write(f"{kind.name}: {len(taught.image)} patches, {len(apart.image)} held out\n")
    generator = torch.Generator().manual_seed(seed)
    begun, step, told = time.monotonic(), 0, 0
    while (share := (time.monotonic() - begun) / (60 * minutes)) < 1:
        for group in optimiser.param_groups:
            group["lr"] = rate * min(1.0, (step + 1) / 100) * max(0.5 * (1 + math.cos(math.pi * share)), 0.01)
        chosen = torch.randint(len(taught.image), (BATCH,), generator=generator)
        shown = whitened(taught.image[chosen], taught.mouth[chosen], generator)
        heights_read, scatter = network(graded(shown, generator))
        value = loss(heights_read, scatter, taught.truth[chosen])
        if not torch.isfinite(value):
            raise ModelFault(f"{kind.name}: the loss is {float(value)} at step {step}")
        optimiser.zero_grad(set_to_none=True)
        value.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        step += 1
        follow(average, network, step, 0.998)
        if 8 * share > told + 1:
            told += 1
            _tell(kind, step, float(value.detach()), measure(average, apart, kind))
    white = Patches(whitened(apart.image, apart.mouth, generator), apart.mouth, apart.truth)
    found = measure(average, apart, kind) | {f"white_{k}": v for k, v in measure(average, white, kind).items()}
    _tell(kind, step, float(value.detach()), found)
    content = {"side": kind.side, "state": average.state_dict(), "steps": step, "held_out": found}
    torch.save(content, out / f"{kind.name}.pt")
    return found


def _tell(kind: OpeningKind, step: int, value: float, found: dict[str, float]) -> None:
    numbers = {"loss": value, **found}
    line = {"kind": kind.name, "step": step, **{name: round(number, 4) for name, number in numbers.items()}}
    sys.stderr.write(json.dumps(line) + "\n")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of shards")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run")
    parser.add_argument("--minutes", type=float, default=10.0, help="for each kind")
    parser.add_argument("--kind", choices=[kind.name for kind in KINDS], help="only this one")
    parser.add_argument("--shipped", action="store_true", help="go on from the service's weights")
    parser.add_argument("--threads", type=int, default=0, help="of torch; 0 leaves its own choice")
    chosen = parser.parse_args()
    if chosen.threads:
        torch.set_num_threads(chosen.threads)
    chosen.out.mkdir(parents=True, exist_ok=True)
    for kind in KINDS:
        if chosen.kind in (None, kind.name):
            train(kind, chosen.data, chosen.out, chosen.minutes, shipped=chosen.shipped)


if __name__ == "__main__":
    main()
