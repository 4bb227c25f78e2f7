"""Hair from what a photo shows of it: ``python -m benchmarks.hair [--count 60] [--worse]``.

Grooms that the bank does not hold, on random heads, seen from random sides by a reader that knows their mask and
directions but no kind: what the search and the fit make of them. ``--worse`` crops, blurs and thins what is read.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping
from typing import Annotated

import numpy as np
import typer

from models.hair.random_styles import sample_style
from service.hair.bank import kind_of, match, read_bank
from service.hair.find_hair import STRANDS_A_TRIAL, across, choose
from service.hair.groom import make_groom
from service.hair.kinds import KINDS, ends_m, kinds_of
from service.hair.scalp import Scalp
from service.hair.shape import fitted
from service.hair.sight import Drawn, Sight, overlap
from service.head.files import load_head
from service.head.model import HeadModel
from service.image_filters import blurred
from tests.support.hair import Photographed, photographed

STRANDS = 6000
AGAIN = 100_000
"""Added to a seed for the same style with other random numbers."""


def worse(seen: Photographed, head: HeadModel, rng: np.random.Generator) -> Photographed:
    """What a poor reader says: soft edges, ends that it misses, and a photo that ends at the chin or at the crown."""
    mask = np.asarray(np.clip(blurred(seen.reading.mask, 1.5) - rng.uniform(0, 0.15), 0, 1), np.float32)
    known = seen.reading.known.copy()
    lowest, highest = int(rng.uniform(0.65, 1.3) * len(known)), int(rng.uniform(-0.3, 0.12) * len(known))
    known[max(lowest, 1) :], known[: max(highest, 0)] = 0, 0
    reading = dataclasses.replace(seen.reading, mask=mask, known=known)
    return dataclasses.replace(seen, reading=reading, sight=Sight.of(reading, seen.fit, head))


def _angle(drawn: Drawn, sight: Sight) -> float:
    """Degrees whose cosine is the mean one between strands and the photo's."""
    return float(np.degrees(np.arccos(np.clip(1 - 2 * across(drawn, sight), -1, 1))))


def measured(seed: int, head: HeadModel, *, poor: bool) -> Mapping[str, float]:
    """Figures of one groom."""
    rng = np.random.default_rng([seed, 0xBE7])
    vertices = head.shape(rng.normal(0, 0.8, 30))
    style = sample_style(seed)
    seen = photographed(style, seed, head, vertices, rng.uniform(-35, 35), rng.uniform(-12, 12), STRANDS)
    seen = worse(seen, head, rng) if poor else seen
    skin = Scalp.of(head, seen.fit.neutral)
    begin = time.process_time()
    matches = match(read_bank(), seen.sight, seen.fit, head, seen.reading)
    chosen = choose(read_bank(), matches, seen.sight, skin, 0, seen.reading, STRANDS // STRANDS_A_TRIAL)
    groom, _ = fitted(chosen, seen.sight, skin, 0, STRANDS)
    spent = time.process_time() - begin
    drawn = seen.sight.drawn(groom.strands)
    # Locks and curls fall by chance: as far from this photo's is the same style with other random numbers.
    again = seen.sight.drawn(make_groom(style, seed + AGAIN, STRANDS, skin).strands)
    truth = photographed(style, seed, head, vertices).groom if poor else seen.groom
    own, wanted = kinds_of(chosen, groom.strands), kinds_of(style, truth.strands)
    figures = {
        "overlap": overlap(seen.sight.hair, drawn.mask, seen.sight.known),
        "direction, degrees": _angle(drawn, seen.sight),
        "direction of the very style": _angle(again, seen.sight),
        "ends, mm off": 1000 * abs(ends_m(groom.strands) - ends_m(truth.strands)) if len(groom) else np.nan,
        "kind right": kind_of(chosen) == kind_of(style),
        "probability of the kind": matches.kinds(read_bank()).get(kind_of(chosen), 0.0),
        "inside the body": float((skin.outside(groom.strands[:, 2:]) < -0.003).mean()) if len(groom) else 0.0,
        "CPU seconds": spent,
    }
    return figures | {f"{name} right": own[name] == wanted[name] for name in KINDS}


def main(
    count: Annotated[int, typer.Option(min=1)] = 60,
    first: Annotated[int, typer.Option(help="Seed of the first.")] = 0,
    poor: Annotated[bool, typer.Option("--worse", help="As a poor reader sees it.")] = False,
) -> None:
    """Print means over grooms."""
    head = load_head()
    rows = [measured(seed, head, poor=poor) for seed in range(first, first + count)]
    for name in rows[0]:
        values = np.array([float(row[name]) for row in rows])
        values = values[np.isfinite(values)]
        typer.echo(f"{name:28s} mean {values.mean():8.3f}   median {np.median(values):8.3f}")


if __name__ == "__main__":
    typer.run(main)
