"""Results of a benchmark, for tables, plots and JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from service.bench.loss import UNITS, Loss
from service.bench.pareto import Line
from service.bench.rates import Rates
from service.bench.stages import Measured
from service.bench.variants import Variant
from service.bench.whole import Made, Whole


@dataclass(frozen=True)
class Row:
    """One variant of one stage.

    Attributes:
        variant: what was run.
        measured: time and memory; None where it failed.
        loss: against the stage's reference; None where it failed.
        floor_s: lower bound of the seconds for the whole chart on this machine; None where it is not known.
        front: whether it is on the Pareto front of its stage.
        fault: why it failed.
    """

    variant: Variant
    measured: Measured | None = None
    loss: Loss | None = None
    floor_s: float | None = None
    front: bool = False
    fault: str = ""


@dataclass(frozen=True)
class WholeRow:
    """One run from photo to archive; ``losses`` by map, against the reference run."""

    run: Whole
    made: Made | None = None
    losses: Mapping[str, Loss] | None = None
    front: bool = False
    fault: str = ""


@dataclass(frozen=True)
class Bench:
    """All results of one benchmark.

    Attributes:
        machine: facts of machine and installation.
        rates: of the machine.
        rows: of all stages.
        wholes: runs from photo to archive.
        line: seconds without super-resolution against megatexels of the map.
        notes: what was left out, and why.
        seconds: duration of the benchmark.
    """

    machine: Mapping[str, Any]
    rates: Rates
    rows: Sequence[Row]
    wholes: Sequence[WholeRow]
    line: Line | None
    notes: Sequence[str]
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """JSON values; numbers that are not finite are null."""
        return {
            "machine": dict(self.machine),
            "rates": asdict(self.rates),
            "stages": [_row(row) for row in self.rows],
            "whole": [_whole(row) for row in self.wholes],
            "line": None if self.line is None else asdict(self.line),
            "notes": list(self.notes),
            "seconds": self.seconds,
        }


def _row(row: Row) -> dict[str, Any]:
    return {
        **asdict(row.variant),
        "label": row.variant.label,
        **(_taken(row.measured, row.fault)),
        "loss": None if row.loss is None else loss_json(row.loss),
        "floor_s": row.floor_s,
        "pareto": row.front,
    }


def _whole(row: WholeRow) -> dict[str, Any]:
    engine = row.run.engine
    return {
        "label": row.run.label, "quality": row.run.quality, "runtime": engine.runtime, "precision": engine.precision,
        "tile": row.run.tile, **_taken(row.made, row.fault),
        "loss": {name: loss_json(loss) for name, loss in (row.losses or {}).items()}, "pareto": row.front,
    }  # fmt: skip


def _taken(taken: Measured | Made | None, fault: str) -> dict[str, Any]:
    return {"fault": fault} if taken is None else asdict(taken)


def loss_json(loss: Loss) -> dict[str, Any]:
    """Numbers and their unit."""
    shown = {"at_own_size": loss.shown(loss.at_own), "at_full_size": loss.shown(loss.at_full)}
    return {"unit": UNITS[loss.kind], **{key: value if math.isfinite(value) else None for key, value in shown.items()}}
