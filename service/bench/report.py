"""A benchmark as a Markdown table and as a plot of loss against seconds."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from service.bench.runs import COMPARED, Bench, Row, shown_loss, sized
from service.errors import UsageError

MARK = ("<!-- bench -->", "<!-- /bench -->")
"""Lines of a file between which the table is replaced."""

HEAD = (
    "run", "networks on", "s", "processor s", "avatars a core-hour", "$ a million", "peak MiB", "MB",
    *(name.replace("_", " ") for name in COMPARED), "front",
)  # fmt: skip

CORE_HOUR = 0.04
"""Dollars of a core for an hour, about what clouds ask for one of their own processors without a contract."""


def as_markdown(bench: Bench) -> str:
    """Machine, table and line."""
    processor = bench.machine["processor"]
    judged = list(next((row.truth for row in bench.rows if row.truth), ()))
    head = [*HEAD[:-1], *judged, HEAD[-1]]
    lines = [
        f"{processor['model']}, {processor['cores']} cores ({' '.join(processor['features'])}), "
        f"{bench.machine['memory_mb']} MiB; {', '.join(bench.machine['runtimes'])}; "
        f"{bench.machine['threads']} threads.",
        f"The benchmark took {bench.seconds:.0f} s.",
        "",
        *_table(head, (_cells(row, judged) for row in bench.rows)),
        "",
        *_stages(bench.rows),
    ]
    if bench.line is not None:
        found = bench.line
        points = "; ".join(f"{area:.2f} Mtexel {seconds:.1f} s" for area, seconds in sized(bench.rows))
        lines += [
            "",
            f"Seconds without super-resolution against the size of the map: {points}. The straight line "
            f"{found.start:.1f} s + {found.slope:.2f} s / Mtexel is off by {100 * found.worst:.0f} % at most.",
        ]
    return "\n".join(lines) + "\n"


def put(text: str, table: str) -> str:
    """A file's text with its table replaced, or with the table at its end where it has no marks."""
    begin, end = MARK
    body = f"{begin}\n{table}{end}"
    if begin in text and end in text:
        return text.split(begin)[0] + body + text.split(end, 1)[1]
    return f"{text.rstrip()}\n\n{body}\n".lstrip()


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    for cells in (head, ["---"] * len(head), *rows):
        yield "| " + " | ".join(cells) + " |"


def _stages(rows: Sequence[Row]) -> Iterator[str]:
    """Seconds of each stage in its order, a column for each run."""
    made = [row for row in rows if not row.fault]
    names = list(dict.fromkeys(name for row in reversed(made) for name in row.timings_s))
    told = ([name, *(f"{row.timings_s[name]:.2f}" if name in row.timings_s else "-" for row in made)] for name in names)
    yield from _table(["seconds of", *(row.label for row in made)], told)


def _cells(row: Row, judged: Sequence[str]) -> list[str]:
    if row.fault:
        return [row.label, row.fault, *[""] * (len(HEAD) + len(judged) - 2)]
    return [
        row.label, row.engines, f"{row.seconds:.1f}", f"{row.processor_s:.1f}", f"{3600 / row.processor_s:.0f}",
        f"{1e6 * row.processor_s / 3600 * CORE_HOUR:.0f}", f"{row.peak_mb:.0f}", f"{row.megabytes:.0f}",
        *(in_words(name, row.losses[name]) if name in row.losses else "-" for name in COMPARED),
        *(f"{row.truth[name]:.2f} dB" if name in row.truth else "-" for name in judged),
        "**front**" if row.front else "",
    ]  # fmt: skip


def in_words(name: str, loss: float) -> str:
    """A map's loss with its unit; "same" where there is none."""
    if loss == 0:
        return "same"
    return f"{shown_loss(name, loss):.1f} dB" if COMPARED[name] == "colour" else f"{loss:.3f} °"


def require_matplotlib() -> None:
    """Raise UsageError where the plot cannot be drawn."""
    if importlib.util.find_spec("matplotlib") is None:
        raise UsageError("the plot needs matplotlib: pip install matplotlib, or leave out -o to get the table only")


def draw(bench: Bench, path: Path) -> None:
    """Write the picture as PNG.

    Raises:
        UsageError: matplotlib is not installed.
    """
    require_matplotlib()
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 5), layout="constrained")
    axis = figure.subplots()
    # An identical map has a place on the logarithmic axis.
    rows = [(row.seconds, max(row.losses["specular_normal"], 1e-4), row) for row in bench.rows if row.losses]
    points = sorted(rows, key=lambda one: one[:2])
    front = [(seconds, loss) for seconds, loss, row in points if row.front]
    axis.plot([seconds for seconds, _ in front], [loss for _, loss in front], "-", color="tab:red", linewidth=1)
    for seconds, loss, row in points:
        axis.plot(seconds, loss, "o", color="tab:red" if row.front else "tab:gray", markersize=7 if row.front else 4)
        place = (4, 5) if row.front else (4, -9)
        axis.annotate(row.label, (seconds, loss), fontsize=7, xytext=place, rotation=30, textcoords="offset points")
    axis.set_xlabel("seconds from the photo to the archive")
    axis.set_xscale("log")
    axis.set_ylabel("specular normals: mean angle to the reference, degrees")
    axis.set_yscale("log")
    axis.margins(x=0.18, y=0.18)
    axis.grid(alpha=0.3)
    figure.savefig(path, dpi=90, metadata={"Software": None})
