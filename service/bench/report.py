"""A benchmark as Markdown tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from service.bench.loss import UNITS, Loss
from service.bench.result import Bench, Row, WholeRow
from service.bench.variants import STAGES
from service.bench.whole import COMPARED, WRITING
from service.bench.whole_rows import sized
from service.runtime.networks import Engine

MARK = ("<!-- bench -->", "<!-- /bench -->")
"""Lines of a file between which the tables are replaced."""

TITLES = {
    "zeta": "zeta: super-resolution, 576 x 384 -> 4608 x 3072",
    "delta": "delta: texture -> diffuse albedo",
    "psi": "psi: diffuse albedo -> specular albedo",
    "rho": "rho: -> specular normals",
    "sigma": "sigma: -> diffuse normals",
    "integration": "integration: specular normals -> heights",
    "encoding": "encoding: codes -> PNG",
}

NOTHING = "-"


def as_markdown(bench: Bench) -> str:
    """All tables."""
    lines = [*_machine(bench), ""]
    for stage in STAGES:
        rows = [row for row in bench.rows if row.variant.stage == stage]
        if rows:
            lines += [f"### {TITLES[stage]}", "", *_stage(rows), ""]
    if bench.wholes:
        lines += ["### The whole, from photo to archive", "", *_wholes(bench.wholes), "", *_line(bench), ""]
    lines += [f"- {note}" for note in bench.notes]
    return "\n".join(lines).rstrip() + "\n"


def put(text: str, tables: str) -> str:
    """A file's text with its tables replaced, or with tables at its end where it has no marks."""
    begin, end = MARK
    body = f"{begin}\n{tables}{end}"
    if begin in text and end in text:
        return text.split(begin)[0] + body + text.split(end, 1)[1]
    return f"{text.rstrip()}\n\n{body}\n".lstrip()


def _machine(bench: Bench) -> list[str]:
    processor = bench.machine["processor"]
    rates = ", ".join(f"{value / 1e9:.0f} GFLOP/s in {name}" for name, value in bench.rates.operations.items())
    return [
        f"{processor['model']}, {processor['cores']} cores ({' '.join(processor['features'])}), "
        f"{bench.machine['memory_mb']} MiB; {', '.join(bench.machine['runtimes'])}; "
        f"{bench.machine['threads']} threads.",
        f"Measured in this run: matrix products {rates}; copies {bench.rates.bytes / 1e9:.1f} GB/s, read and written "
        f"bytes together. The benchmark took {bench.seconds:.0f} s.",
    ]


def _stage(rows: Sequence[Row]) -> Iterable[str]:
    files = any(row.measured and row.measured.megabytes is not None for row in rows)
    head = ["variant", "loss", "at its own size", "s / map", "x floor", "peak MiB", *(["MB"] if files else []), "front"]
    return _table(head, [_cells(row, files) for row in rows])


def _cells(row: Row, files: bool) -> list[str]:
    if row.measured is None or row.loss is None:
        return [row.variant.label, row.fault, *[""] * (6 if files else 5)]
    taken = row.measured
    gap = NOTHING if not row.floor_s else f"{taken.seconds / row.floor_s:.1f}"
    size = [NOTHING if taken.megabytes is None else f"{taken.megabytes:.1f}"] if files else []
    own, full = (shown(row.loss, error) for error in (row.loss.at_own, row.loss.at_full))
    label = row.variant.label if row.variant.stage != "encoding" else row.variant.knob
    return [
        label,
        full,
        own,
        f"{taken.seconds:.2f}",
        gap,
        f"{taken.peak_mb:.0f}",
        *size,
        "**front**" if row.front else "",
    ]


def shown(loss: Loss, error: float) -> str:
    """A loss with its unit; "same" where there is none."""
    if error == 0:
        return "same"
    digits = {"colour": 1, "normal": 3, "height": 3}[loss.kind]
    return f"{loss.shown(error):.{digits}f} {UNITS[loss.kind]}"


def _wholes(rows: Sequence[WholeRow]) -> Iterable[str]:
    names = list(COMPARED)
    head = [
        "run",
        "networks on",
        "s",
        "networks s",
        "writing s",
        "peak MiB",
        "MB",
        *(name.replace("_", " ") for name in names),
        "front",
    ]
    cells = []
    for row in rows:
        if row.made is None:
            cells.append([row.run.label, row.fault, *[""] * (len(head) - 2)])
            continue
        made = row.made
        networks = sum(made.timings_s.get(name, 0.0) for name in ("super_resolution", *COMPARED))
        losses = [shown(loss, loss.at_full) if (loss := (row.losses or {}).get(name)) else NOTHING for name in names]
        cells.append([
            row.run.label, engine_in_words(row.run.engine), f"{made.seconds:.1f}", f"{networks:.1f}",
            f"{made.timings_s[WRITING]:.1f}",
            f"{made.peak_mb:.0f}", f"{made.megabytes:.0f}", *losses, "**front**" if row.front else "",
        ])  # fmt: skip
    return _table(head, cells)


def engine_in_words(engine: Engine) -> str:
    """Runtime and precision, with the networks that are an exception."""
    plain = f"{engine.runtime} {engine.precision}"
    return plain + (f" ({', '.join(sorted(engine.exceptions))}: openvino fp32)" if engine.exceptions else "")


def _line(bench: Bench) -> list[str]:
    if bench.line is None:
        return []
    points = "; ".join(f"{area:.2f} Mtexel {seconds:.1f} s" for area, seconds in sorted(sized(bench.wholes)))
    found = bench.line
    return [
        f"Seconds without super-resolution against the size of the map: {points}. The straight line "
        f"{found.start:.1f} s + {found.slope:.2f} s / Mtexel is off by {100 * found.worst:.0f} % at most."
    ]


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return ["| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *rows)]
