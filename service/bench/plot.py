"""Plot of a benchmark: loss against seconds for each stage and the whole run, with the Pareto front."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from service.bench.loss import UNITS
from service.bench.result import Bench
from service.bench.variants import STAGES
from service.errors import UsageError

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
