"""Patches a second and what they cost by part: ``python -m models.lightstage.bench``."""

from __future__ import annotations

import cProfile
import pstats
import time
from typing import Annotated

import torch
import typer

from models.lightstage.skin.synthesis import Skin
from models.lightstage.skin.window import ChartWindow
from models.lightstage.stage import Stage

PARTS = {
    "geometry and base maps": ("atlas.py", "enlarge"),
    "metric": ("atlas.py", "of"),
    "relief": ("relief.py", "height"),
    "pores": ("pores.py", "draw_pores"),
    "spots": ("spots.py", "draw_spots"),
    "vessels, scars": ("spots.py", "draw_lines"),
    "wrinkles": ("wrinkles.py", "draw_wrinkles"),
    "hair": ("hair.py", "draw_strands"),
    "pigment noise": ("colour.py", "noises"),
    "normals": ("normals.py", "normals_of"),
    "diffuse normals": ("normals.py", "diffuse_normals"),
    "cavities": ("stack.py", "build"),
    "albedo": ("colour.py", "diffuse_albedo"),
    "gloss": ("gloss.py", "specular_albedo"),
}
"""Functions that are timed, by file and name; ``cavities`` counts the blur stack of the diffuse normals as well."""


def windows(count: int, size: int) -> list[ChartWindow]:
    """Places all over the face, spread by the golden ratio."""
    return [
        ChartWindow(1500 + int(2600 * ((i * 0.618034) % 1.0)), 500 + int(2600 * ((i * 0.754878) % 1.0)), size, size)
        for i in range(count)
    ]


def measure(skin: Skin, places: list[ChartWindow]) -> tuple[float, float, dict[str, float]]:
    """Seconds and processor seconds a window without the profiler, and seconds a window of each part with it."""
    skin.maps(places[0])
    start, busy = time.perf_counter(), time.process_time()
    for window in places:
        skin.maps(window)
    synchronise(skin)
    plain = (time.perf_counter() - start) / len(places)
    processor = (time.process_time() - busy) / len(places)
    profile = cProfile.Profile()
    profile.enable()
    for window in places:
        skin.maps(window)
    profile.disable()
    parts = dict.fromkeys(PARTS, 0.0)
    for (file, _, function), row in pstats.Stats(profile).stats.items():  # type: ignore[attr-defined]
        for name, (wanted, called) in PARTS.items():
            if file.endswith(f"skin/{wanted}") and function == called:
                parts[name] += row[3] / len(places)
    return plain, processor, parts


def synchronise(skin: Skin) -> None:
    """Wait for the accelerator, if the skin lives on one."""
    if skin.device.type == "cuda":
        torch.cuda.synchronize()


def main(
    count: Annotated[int, typer.Option(min=1, help="Windows to draw.")] = 6,
    size: Annotated[int, typer.Option(min=64, help="Side of a window.")] = 512,
    seed: Annotated[int, typer.Option(help="The person.")] = 1000,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    threads: Annotated[int, typer.Option(min=1)] = 2,
) -> None:
    """Print seconds for setting up a person, patches of 512 a second, and the cost by part."""
    torch.set_num_threads(threads)
    start = time.perf_counter()
    stage = Stage.open()
    opened = time.perf_counter() - start
    stage.skin(seed, device=device)
    start = time.perf_counter()
    skin = stage.skin(seed + 1, device=device)
    prepared = time.perf_counter() - start
    places = windows(count, size)
    plain, processor, parts = measure(skin, places)
    halo = skin.halo(places[0])
    typer.echo(f"stage {opened:.1f} s once, person {prepared:.2f} s")
    typer.echo(f"window {size}^2: {plain:.2f} s, {processor:.2f} s of processor, halo {halo}")
    typer.echo(f"{size * size / 512**2 / plain:.2f} patches of 512^2 a second on {threads} threads of {device}")
    for name, seconds in sorted(parts.items(), key=lambda item: -item[1]):
        typer.echo(f"  {name:24s} {1000 * seconds:7.1f} ms")


if __name__ == "__main__":
    typer.run(main)
