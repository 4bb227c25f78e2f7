"""A benchmark as Markdown tables, as JSON values and as a plot of loss against seconds."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from service.bench.losses import UNITS, Loss
from service.bench.variants import STAGES, Bench, Row, WholeRow
from service.bench.whole import COMPARED, WRITING, sized
from service.errors import UsageError
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
    return [
        f"{processor['model']}, {processor['cores']} cores ({' '.join(processor['features'])}), "
        f"{bench.machine['memory_mb']} MiB; {', '.join(bench.machine['runtimes'])}; "
        f"{bench.machine['threads']} threads.",
        f"The benchmark took {bench.seconds:.0f} s.",
    ]


def _stage(rows: Sequence[Row]) -> Iterable[str]:
    files = any(row.measured and row.measured.megabytes is not None for row in rows)
    head = ["variant", "loss", "at its own size", "s / map", "peak MiB", *(["MB"] if files else []), "front"]
    return _table(head, [_cells(row, files) for row in rows])


def _cells(row: Row, files: bool) -> list[str]:
    if row.measured is None or row.loss is None:
        return [row.variant.label, row.fault, *[""] * (5 if files else 4)]
    taken = row.measured
    size = [NOTHING if taken.megabytes is None else f"{taken.megabytes:.1f}"] if files else []
    own, full = (shown(row.loss, error) for error in (row.loss.at_own, row.loss.at_full))
    label = row.variant.label if row.variant.stage != "encoding" else row.variant.knob
    return [
        label,
        full,
        own,
        f"{taken.seconds:.2f}",
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


LEAST = {"colour": 99.0, "normal": 1e-4, "height": 1e-3}
"""Loss at which an identical map is drawn, in ``UNITS``."""

WHOLE = "specular_normal"
"""Map whose loss is drawn for whole runs."""


def require_matplotlib() -> None:
    """Raise UsageError where the plot cannot be drawn."""
    if importlib.util.find_spec("matplotlib") is None:
        raise UsageError("the plot needs matplotlib: pip install matplotlib, or leave out -o to get the tables only")


def draw(bench: Bench, path: Path) -> None:
    """Write the picture as PNG.

    Raises:
        UsageError: matplotlib is not installed.
    """
    require_matplotlib()
    from matplotlib.figure import Figure

    stages = [stage for stage in STAGES if any(row.variant.stage == stage for row in bench.rows)]
    columns = 4
    count = len(stages) + bool(bench.wholes)
    lines = -(-count // columns)
    figure = Figure(figsize=(4.6 * columns, 4.0 * lines), layout="constrained")
    axes = figure.subplots(lines, columns, squeeze=False).ravel()
    for axis, stage in zip(axes, stages, strict=False):
        points = [
            (row.variant.label if stage != "encoding" else row.variant.knob, row.measured.seconds, row.loss, row.front)
            for row in bench.rows if row.variant.stage == stage and row.measured and row.loss
        ]  # fmt: skip
        if stage == "encoding":
            points = [point for point in points if point[2].kind == "normal"]
        _panel(axis, stage, points)
    if bench.wholes:
        points = [
            (row.run.label, row.made.seconds, row.losses[WHOLE], row.front)
            for row in bench.wholes if row.made and row.losses and WHOLE in row.losses
        ]  # fmt: skip
        _panel(axes[len(stages)], "the whole: specular normals", points)
    for axis in axes[count:]:
        axis.set_visible(False)
    figure.savefig(path, dpi=90, metadata={"Software": None})


def _panel(axis: Any, title: str, points: Sequence[tuple[str, float, Any, bool]]) -> None:
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

    if not points:
        axis.set_title(f"{title}: nothing")
        return
    kind = points[0][2].kind
    best_value = LEAST[kind]
    sign = -1 if kind == "colour" else 1
    line: list[tuple[float, float]] = []
    for label, seconds, loss, best in sorted(points, key=lambda point: point[1]):
        value = loss.shown(loss.at_full)
        value = value if kind == "colour" else max(value, best_value)
        axis.plot(seconds, value, "o", color="tab:red" if best else "tab:gray", markersize=7 if best else 4)
        if best and (not line or sign * value < sign * line[-1][1]):  # the front may have a third quantity: bytes
            line.append((seconds, value))
        if best or value != best_value:  # points without loss would overlap; they are in the tables
            place = (5, 4) if best else (5, -8)
            axis.annotate(label, (seconds, value), fontsize=6, xytext=place, textcoords="offset points")
    axis.plot([seconds for seconds, _ in line], [value for _, value in line], "-", color="tab:red", linewidth=1)
    axis.set_title(title)
    axis.set_xlabel("seconds for a whole chart")
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.margins(x=0.18, y=0.1)
    axis.set_ylabel(f"loss against the reference, {UNITS[kind]}")
    if kind == "colour":
        axis.invert_yaxis()
    else:
        axis.set_yscale("log")
    axis.grid(alpha=0.3)
