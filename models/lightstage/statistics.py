"""Statistics of synthetic skin against real: ``python -m models.lightstage.statistics --data DIR``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from models.lightstage.measures import Patch, band, correlation, describe, log_luminance, slopes
from models.lightstage.references import HIFI_PPM, SCAN_PPM, reference_patches
from models.lightstage.stage import Stage
from service.errors import UsageError

FULL_PPM = 14.0
HIGH_PASS_MM = (0.15, 1.5)
ENVIRONMENT = "AVATARME_BENCH_DATA"


def synthetic_patches(stage: Stage, seed: int, size: int = 512) -> list[Patch]:
    """Cheek and forehead of one person at full size and shrunk to the two real resolutions."""
    result = []
    skin = stage.skin(seed)
    for place in ("cheek", "forehead"):
        maps = skin.maps(stage.window(*stage.places()[place], size))
        albedo = maps.diffuse_albedo.permute(1, 2, 0).double().numpy()
        slope = slopes(maps.specular_normal.permute(1, 2, 0).numpy())
        slope = slope - slope.mean((1, 2), keepdims=True)
        gloss = maps.specular_albedo[0].double().numpy()
        result.append(Patch(f"{seed} {place}", albedo, slope, FULL_PPM, gloss))
        for ppm in (HIFI_PPM, SCAN_PPM):
            times = round(FULL_PPM / ppm)
            result.append(shrunk(result[-1 if times == 2 else -2], times))
    return result


def shrunk(patch: Patch, times: int) -> Patch:
    """Means of blocks of ``times`` texels: what a coarser scan would see."""
    h, w = (n // times * times for n in patch.albedo.shape[:2])
    albedo = patch.albedo[:h, :w].reshape(h // times, times, w // times, times, 3).mean((1, 3))
    slope, gloss = None, None
    if patch.slope is not None:
        slope = patch.slope[:, :h, :w].reshape(2, h // times, times, w // times, times).mean((2, 4))
    if patch.gloss is not None:
        gloss = patch.gloss[:h, :w].reshape(h // times, times, w // times, times).mean((1, 3))
    return Patch(f"{patch.name} /{times}", albedo, slope, patch.texels_per_mm / times, gloss)


def oracle_gap(stage: Stage, seed: int) -> float:
    """Correlation of high-passed albedo with depth on a cheek: how much of the relief colour gives away."""
    maps = stage.skin(seed).maps(stage.window(*stage.places()["cheek"], 384))
    albedo = log_luminance(maps.diffuse_albedo.permute(1, 2, 0).double().numpy())
    depth = -maps.height_mm[0].double().numpy()
    return correlation(band(albedo, FULL_PPM, *HIGH_PASS_MM), band(depth, FULL_PPM, *HIGH_PASS_MM))


def table(groups: dict[str, list[dict[str, float]]]) -> str:
    """Markdown: a row per number, a column per group with median and range."""
    names = list(dict.fromkeys(key for rows in groups.values() for row in rows for key in row))
    lines = [f"| | {' | '.join(groups)} |", f"|---|{'---|' * len(groups)}"]
    for name in names:
        cells = []
        for rows in groups.values():
            values = np.array([row.get(name, np.nan) for row in rows])
            values = values[np.isfinite(values)]
            if not len(values):
                cells.append("-")
                continue
            low, middle, high = np.quantile(values, [0.0, 0.5, 1.0])
            digits = 2 if name.startswith(("corr", "oracle")) else 1
            cells.append(f"{middle:.{digits}f} ({low:.{digits}f} .. {high:.{digits}f})")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main(
    data: Annotated[Path | None, typer.Option(help=f"Folder of reference scans; default ${ENVIRONMENT}.")] = None,
    seeds: Annotated[int, typer.Option(min=1, help="How many subjects.")] = 12,
    first: Annotated[int, typer.Option(help="First seed.")] = 1000,
) -> None:
    """Print a table of medians and ranges, real beside synthetic at the same resolution."""
    folder = data or (Path(os.environ[ENVIRONMENT]) if ENVIRONMENT in os.environ else None)
    if folder is None:
        raise UsageError(f"give --data or set {ENVIRONMENT}")
    real = reference_patches(folder)
    stage = Stage.open()
    made = [p for seed in range(first, first + seeds) for p in synthetic_patches(stage, seed)]
    # All references are light skin: like is compared with like.
    light = [p for p in made if describe(p)["ITA"] > 28.0]

    def group(patches: list[Patch], ppm: float) -> list[dict[str, float]]:
        return [describe(p) for p in patches if abs(p.texels_per_mm / ppm - 1.0) < 0.2]

    columns = {
        "hifi3d, 7.6 px/mm": group(real, HIFI_PPM),
        "synthetic light, 7": group(light, 7.0),
        "Lee Perry-Smith, 2.65": group(real, SCAN_PPM),
        "synthetic light, 2.8": group(light, 2.8),
        "synthetic light, 14": group(light, FULL_PPM),
        "synthetic all, 14": group(made, FULL_PPM),
    }
    for row, seed in zip(
        columns["synthetic all, 14"], [s for s in range(first, first + seeds) for _ in "12"], strict=True
    ):
        row["oracle: albedo against depth"] = oracle_gap(stage, seed)
    typer.echo(table(columns))


if __name__ == "__main__":
    typer.run(main)
