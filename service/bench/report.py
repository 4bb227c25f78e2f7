"""A benchmark as a Markdown table and as a plot of loss against seconds."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from service.bench.runs import COMPARED, Bench, Row, shown_loss, sized
from service.errors import UsageError

MARK = ("<!-- bench -->", "<!-- /bench -->")
"""Lines of a file between which the table is replaced."""

HEAD = (
    "run", "networks on", "s", "networks s", "writing s", "peak MiB", "MB",
    *(name.replace("_", " ") for name in COMPARED), "front",
)  # fmt: skip


def as_markdown(bench: Bench) -> str:
    """Machine, table and line."""
    processor = bench.machine["processor"]
    lines = [
        f"{processor['model']}, {processor['cores']} cores ({' '.join(processor['features'])}), "
        f"{bench.machine['memory_mb']} MiB; {', '.join(bench.machine['runtimes'])}; "
        f"{bench.machine['threads']} threads.",
        f"The benchmark took {bench.seconds:.0f} s.",
        "",
        *("| " + " | ".join(cells) + " |" for cells in (HEAD, ["---"] * len(HEAD), *map(_cells, bench.rows))),
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


def _cells(row: Row) -> list[str]:
    if row.fault:
        return [row.label, row.fault, *[""] * (len(HEAD) - 2)]
    return [
        row.label, row.engines, f"{row.seconds:.1f}", f"{row.networks_s:.1f}", f"{row.timings_s['write']:.1f}",
        f"{row.peak_mb:.0f}", f"{row.megabytes:.0f}",
        *(in_words(name, row.losses[name]) if name in row.losses else "-" for name in COMPARED),
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
