"""A benchmark as Markdown tables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from service.bench.runs import COMPARED, Bench, Row, shown_loss, sized

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
