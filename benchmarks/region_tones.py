"""Regions of real skins over their cheeks, beside training charts: ``python -m benchmarks.region_tones CAPTURES``.

What a network expects of a region is what it gives where shade and pigment cannot be told apart, so the charts that it
is trained on should have the means of real skin, and a spread at least as wide. Real skins are those of the rendered
photos of ``benchmarks.corrections`` (``--data`` is its folder), whose true albedo the program's fit lays on the chart;
CAPTURES is a folder of ``models.training.factory``. Of each region: mean luminance over that of the cheeks, by skin;
mean and standard deviation of its logarithm over the skins, and over painted training charts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import typer

from benchmarks.albedo import brightness
from benchmarks.corrections.__main__ import CACHE
from benchmarks.corrections.photos import photos
from benchmarks.corrections.score import Judge
from benchmarks.metrics import at_chart
from benchmarks.shoot import data_folder
from models.tables import tell
from service.options import Options
from service.pipeline import make_avatar

Float = npt.NDArray[np.float64]

MARK = ("<!-- region-tones -->", "<!-- /region-tones -->")
SKINS = {
    "FFHQ-UV": ("ffhq_soft", "ffhq_left"), "hifi3d 1": ("hifi1_soft", "oily_left"),
    "hifi3d 2": ("hifi2_left", "oily_overhead"), "hifi3d 3": ("hifi3_overhead", "smile_soft"),
    "Lee Perry-Smith": ("scan_soft", "scan_right"),
}  # fmt: skip
"""Two photos each of ``benchmarks.corrections.photos``."""

REGIONS: Mapping[str, tuple[str, ...]] = {
    "cheeks": ("cheek_left", "cheek_right"), "forehead": ("forehead",), "brows": ("brow_left", "brow_right"),
    "lids": ("eyelid_left", "eyelid_right"), "nose": ("nose",), "lips": ("lips",), "chin": ("chin",),
    "beard": ("beard",), "neck": ("neck",),
}  # fmt: skip


def real_brightness(data: Path, cache: Path, planes: Mapping[str, Float]) -> dict[str, dict[str, float]]:
    """Of each skin: regions over the cheeks, means of its photos."""
    found: dict[str, dict[str, float]] = {}
    options = Options(maps=("texture",), quality="draft", face="largest")
    for photo in photos(data, cache, [name for names in SKINS.values() for name in names]):
        judge = Judge.of(photo, make_avatar(photo.data, options))
        weights = {name: at_chart(plane[..., None], judge.uv)[:, 0] for name, plane in planes.items()}
        found[photo.name] = brightness(judge.truth, weights)
    return {
        skin: {
            region: float(np.mean([found[name][region] for name in names if region in found[name]] or [np.nan]))
            for region in planes
        }
        for skin, names in SKINS.items()
    }


def trained_brightness(captures: Path, batches: int, planes: Mapping[str, Float]) -> list[dict[str, float]]:
    """Of training charts, six a batch, as they are painted."""
    import torch

    from models.training.context import ContextTask

    task, generator = ContextTask(captures), torch.Generator().manual_seed(7)
    task.refresh()
    weights = {name: plane.ravel() for name, plane in planes.items()}
    charts = torch.cat([task.batch(6, generator)["albedo"] for _ in range(batches)]).double().numpy()
    return [brightness(chart.reshape(3, -1).T, weights) for chart in charts]


def table(real: Mapping[str, Mapping[str, float]], trained: Sequence[Mapping[str, float]]) -> list[str]:
    """Markdown: a row for each region but the cheeks."""
    lines = [f"| over the cheeks | {' | '.join(real)} | mean of logs | spread | in training: mean | spread |"]
    lines.append("|---" * (len(real) + 5) + "|")
    for name in list(REGIONS)[1:]:
        each = np.array([skin.get(name, np.nan) for skin in real.values()])
        logs = (
            np.log(np.maximum(values[np.isfinite(values)], 1e-3))
            for values in (each, np.array([chart.get(name, np.nan) for chart in trained]))
        )
        told = [*each, *(number for values in logs for number in _moments(values))]
        lines.append(f"| {name} | {' | '.join('-' if np.isnan(value) else f'{value:.2f}' for value in told)} |")
    return lines


def _moments(values: Float) -> tuple[float, float]:
    return (float(values.mean()), float(values.std())) if len(values) else (float("nan"), float("nan"))


def main(
    captures: Annotated[Path, typer.Argument(help="Folder of training captures.")],
    data: Annotated[Path | None, typer.Option(help="Folder of reference heads; else $AVATARME_BENCH_DATA.")] = None,
    cache: Annotated[Path, typer.Option(help="Folder that keeps what was rendered.")] = CACHE,
    batches: Annotated[int, typer.Option(min=1, help="Of six training charts.")] = 16,
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the table into.")] = None,
) -> None:
    """Print the table."""
    from models.training.regions import region_planes

    planes = dict(zip(REGIONS, region_planes(*REGIONS.values()).double().numpy(), strict=True))
    cache.mkdir(parents=True, exist_ok=True)
    real = real_brightness(data_folder(None if data is None else str(data)), cache, planes)
    tell("\n".join(table(real, trained_brightness(captures, batches, planes))), MARK, write)


if __name__ == "__main__":
    typer.run(main)
