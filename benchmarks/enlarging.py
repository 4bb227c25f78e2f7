"""What any enlargement of a fitted texture could know: ``python -m benchmarks.enlarging --captures build/captures``.

A texel of the 576 x 384 texture covers 64 of the 4608 x 3072 one. The best linear estimate of those 64 from the small
texels around (least squares over all training patches, three colours, after what bicubic says) is a bound that needs
no network: were fine skin to be told from coarse, part of it would be linear. Told for textures that are blurred and
noisy as fitted ones are, and for exact ones: PSNR in dB of held-out patches by bicubic and by that estimate.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer
from torch import Tensor
from torch.nn import functional

from models.networks.rcan import SCALE
from models.tables import tell
from models.training.super_resolution import SMALL, ZetaTask, as_fitted, bicubic, large_mask
from models.training.tasks import Batch, psnr

MARK = ("<!-- enlarging -->", "<!-- /enlarging -->")
AROUND = 3
"""Small texels to each side that the estimate sees."""
RIDGE = 1e-4
"""Share of the mean square of the inputs that steadies the least squares."""
INSIDE = 0.9
SEED = 1


def inputs(small: Tensor) -> Tensor:
    """(h w, 148) float64: the small texels around each less the one in the middle, and 1."""
    side = 2 * AROUND + 1
    around = functional.unfold(functional.pad(small, (AROUND,) * 4, mode="replicate"), side)[0].T
    middle = small[0].flatten(1).T.repeat_interleave(side * side, 1)
    return torch.cat([around - middle, torch.ones(len(around), 1)], 1).double()


def estimated(small: Tensor, weights: Tensor) -> Tensor:
    """(1, 3, 8 h, 8 w): bicubic and what the weights (148, 192) add to it."""
    height, width = small.shape[2:]
    added = (inputs(small) @ weights).T.float()[None]
    return bicubic(small) + functional.fold(added, (height * SCALE, width * SCALE), SCALE, stride=SCALE)


def learnt(pairs: list[Batch]) -> Tensor:
    """(148, 192) weights by least squares over small textures and what bicubic lacks of the large ones."""
    square, mixed = torch.zeros(1, dtype=torch.float64), torch.zeros(1, dtype=torch.float64)
    for pair in pairs:
        small = pair["small"][None]
        inside = pair["mask"].flatten() > INSIDE
        known = inputs(small)[inside]
        lacking = functional.unfold(pair["large"][None] - bicubic(small), SCALE, stride=SCALE)[0].T[inside].double()
        square, mixed = square + known.T @ known, mixed + known.T @ lacking
    steady = RIDGE * square.diag().mean() * torch.eye(len(square), dtype=torch.float64)
    return torch.linalg.solve(square + steady, mixed)


def scores(pairs: list[Batch], weights: Tensor) -> tuple[float, float]:
    """Median PSNR in dB by bicubic and by the estimate."""
    found = []
    for pair in pairs:
        small, large = pair["small"][None], pair["large"][None]
        mask = large_mask({"mask": pair["mask"][None]})
        both = (bicubic(small), estimated(small, weights))
        found.append([psnr(image.clamp(0.0, 1.0), large, mask) for image in both])
    cubic, linear = np.median(found, 0)
    return float(cubic), float(linear)


def pairs_of(task: ZetaTask, part: str, fitted: bool) -> list[Batch]:
    """Small and large textures of all patches of a part."""
    generator = torch.Generator().manual_seed(SEED)
    pairs = [task.pair(item) for item in (task.train if part == "train" else task.test).items]
    if not fitted:
        return pairs
    return [pair | {"small": as_fitted(pair["small"][None], generator)[0]} for pair in pairs]


def main(
    captures: Annotated[Path, typer.Option(help="Folder of captures.")] = Path("build/captures"),
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the table into.")] = None,
) -> None:
    """Print the table."""
    task = ZetaTask(captures, SMALL)
    task.refresh()
    lines = ["| texture | bicubic dB | best linear estimate dB |", "|---|---|---|"]
    for name, fitted in (("as fitted", True), ("exact", False)):
        cubic, linear = scores(pairs_of(task, "held-out", fitted), learnt(pairs_of(task, "train", fitted)))
        lines.append(f"| {name} | {cubic:.2f} | {linear:.2f} |")
    counts = f"Medians of {len(task.test.items)} held-out patches, weights of {len(task.train.items)} others."
    tell("\n".join([*lines, "", counts]), MARK, write)


if __name__ == "__main__":
    typer.run(main)
