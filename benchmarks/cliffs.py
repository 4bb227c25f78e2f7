"""Integration across a cliff, by closed form: ``python -m benchmarks.cliffs [--write docs/reflectance.md]``.

Relief that is torn along a line: by most in the middle, exp(-(y / 4 mm)^2) times the jump, and not at all at the ends.
Slopes, with noise, do not show the jump, and no continuous surface has them. Printed are root mean square errors in
micrometres within 1 mm of the tear and further than 3 mm from it, and processor seconds, of least squares, of bilateral
normal integration (Cao et al. 2022, eq. 16 to 18, weights of k = 2 and of k = 50, at most 40 rounds), and of the
program's way (``service.reflectance.relief.cliffs``); then the same without any jump.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
import typer
from scipy.sparse.linalg import spsolve

from models.tables import tell
from service.reflectance.relief.cliffs import integrate_robustly
from service.reflectance.relief.integrate import integrate

Array = npt.NDArray[np.float64]

MARK = ("<!-- cliffs -->", "<!-- /cliffs -->")
TALL, WIDE, MM = 128, 180, 0.28
BILATERAL_ROUNDS = 40
CASES = ((0.6, 0.0), (0.6, 1.0), (0.6, 3.0), (0.2, 1.0), (0.0, 1.0), (0.0, 3.0))
"""Jump in mm, noise of the slopes in degrees."""


def torn(jump_mm: float, noise_deg: float) -> tuple[Array, Array, Array, Array]:
    """Height in mm, its change per texel right and down, distance from the tear in mm; (TALL, WIDE) each."""
    row, column = np.mgrid[:TALL, :WIDE]
    y, x = (row - TALL / 2) * MM, (column + 0.5 - WIDE // 2) * MM
    jump = jump_mm * np.exp(-((y / 4) ** 2)) * (x > 0)
    height = jump + 0.05 * np.sin(2 * x) * np.sin(1.5 * y)
    right, down = 0.1 * np.cos(2 * x) * np.sin(1.5 * y), 0.075 * np.sin(2 * x) * np.cos(1.5 * y) - y / 8 * jump
    rng, noise = np.random.default_rng(2), np.tan(np.radians(noise_deg))
    return height, *((slope + rng.normal(0, noise, y.shape)) * MM for slope in (right, down)), np.abs(x)


def bilateral(right: Array, down: Array, k: float) -> Array:
    """Heights by one-sided differences that are weighted at each texel by how well they and their opposites are met."""
    index = np.arange(TALL * WIDE).reshape(TALL, WIDE)
    rows: list[Any] = []
    for slope, near, far in ((right, index[:, :-1], index[:, 1:]), (down, index[:-1], index[1:])):
        count = near.size
        signs = np.repeat([-1.0, 1.0], count)
        places = (np.tile(np.arange(count), 2), np.concatenate([near.ravel(), far.ravel()]))
        step = sp.csr_matrix((signs, places), (count, index.size))
        forward, backward = slope.ravel()[near.ravel()], slope.ravel()[far.ravel()]
        rows.append((step, near.ravel(), far.ravel(), forward, backward))
    height = np.zeros(index.size)
    weights = [(np.full(len(near), 0.5), np.full(len(near), 0.5)) for _, near, *_ in rows]
    for _ in range(BILATERAL_ROUNDS):
        normal, known = sp.csr_matrix((index.size, index.size)), np.zeros(index.size)
        for (step, _, _, forward, backward), (one, other) in zip(rows, weights, strict=True):
            normal = normal + step.T @ sp.diags(one + other) @ step
            known += step.T @ (one * forward + other * backward)
        found = np.append(0.0, spsolve(normal[1:, 1:].tocsc(), known[1:]))
        settled = np.abs(found - height).max() < 1e-4
        height, weights = found, []
        for step, near, far, forward, backward in rows:
            ahead, behind = np.zeros(index.size), np.zeros(index.size)
            ahead[near], behind[far] = ((step @ height - part) / MM for part in (forward, backward))
            share = 1 / (1 + np.exp(-np.clip(k * (behind**2 - ahead**2), -50, 50)))
            weights.append((share[near], 1 - share[far]))
        if settled:
            break
    return height.reshape(TALL, WIDE)


def ways(right: Array, down: Array) -> dict[str, Callable[[], Array]]:
    """What is compared."""
    one, two = right.astype(np.float32), down.astype(np.float32)
    everywhere, texel = np.ones((TALL, WIDE), bool), np.full((TALL, WIDE), MM, np.float32)

    def plain() -> Any:
        return integrate(one, two, everywhere).height

    return {
        "least squares": plain,
        "bilateral, k = 2": lambda: bilateral(right, down, 2.0),
        "bilateral, k = 50": lambda: bilateral(right, down, 50.0),
        "cliffs kept": lambda: np.asarray(integrate_robustly(one, two, everywhere, texel, plain()).height, np.float64),
    }


def table() -> list[str]:
    """Markdown."""
    names = list(ways(*torn(0, 0)[1:3]))
    lines = ["| jump, noise | " + " | ".join(f"{name}: near, away µm, s" for name in names) + " |", "|---" * 5 + "|"]
    for jump, noise in CASES:
        height, right, down, distance = torn(jump, noise)
        cells = []
        for work in ways(right, down).values():
            begin = time.process_time()
            gap = work() - height
            seconds = time.process_time() - begin
            parts = [gap[where] - np.median(gap[where]) for where in (distance < 1, distance > 3)]
            near, away = (1000 * float(np.sqrt(np.square(part).mean())) for part in parts)
            cells.append(f"{near:.1f}, {away:.1f}, {seconds:.2f}")
        lines.append(f"| {jump} mm, {noise:.0f} deg | " + " | ".join(cells) + " |")
    return lines


def main(
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the table into.")] = None,
) -> None:
    """Print the table."""
    tell("\n".join(table()), MARK, write)


if __name__ == "__main__":
    typer.run(main)
