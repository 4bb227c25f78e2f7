"""Learns the Gaussian of whole albedo maps: ``python -m models.training.albedo_prior --data DIR``.

Principal components of log albedo over the charts of captures and their mirror images, for
``service.reflectance.completion``. How far the components are trusted is what completes other subjects best: each
capture in turn is left out, half hidden as photos hide it, and completed; the command prints the error on hidden skin
beside that of the mean colour of the seen skin.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import numpy.typing as npt
import torch
import typer

from models.training.cover import Cover
from models.training.store import Wholes
from service.colour import srgb_to_linear
from service.errors import UsageError
from service.reflectance.completion import FILE, AlbedoPrior

Float = npt.NDArray[np.float32]

WIDTH, HEIGHT = 96, 64
DARKEST = 1e-3
"""Linear albedo at which logarithms stop."""
OFFSET = 0.5
"""Standard deviation of the logarithm of what devices differ by, each channel apart."""
NOISES = (0.2, 0.4, 0.8, 1.6, 3.2)
"""What is tried; the components leave less, but they leave it to whole regions at once."""
AS_GOOD = 1.02
"""Times the least error up to which another noise counts as as good."""
FEWEST = 4
"""Fewest captures by which one can be left out."""


def log_albedo(coded: npt.NDArray[np.uint8]) -> Float:
    """(3, HEIGHT, WIDTH) natural logarithm of the means of linear albedo of a capture's (3, h, w) sRGB codes."""
    linear = srgb_to_linear(coded.astype(np.float32) / np.float32(255))
    small = [cv2.resize(plane, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA) for plane in linear]
    return np.log(np.maximum(np.stack(small), DARKEST)).astype(np.float32)


def learnt(maps: Float, inside: Float, count: int, noise: float) -> AlbedoPrior:
    """Prior by ``count`` components of (N, 3, h, w) maps and their mirror images, and an offset of each channel."""
    both = np.concatenate([maps, maps[..., ::-1]])
    mean = both.mean(0)
    _, spread, rows = np.linalg.svd((both - mean).reshape(len(both), -1), full_matrices=False)
    count = min(count, len(maps) - 1)
    components = (spread[:count, None] / np.sqrt(len(both)) * rows[:count]).reshape(count, *mean.shape)
    offsets = np.zeros((3, *mean.shape))
    offsets[range(3), range(3)] = OFFSET
    return AlbedoPrior(mean, np.concatenate([components, offsets]).astype(np.float32), noise, inside)


def hidden_error(prior: AlbedoPrior, truth: Float, lit: Float, skin: Float) -> tuple[float, float]:
    """Root mean square of log albedo on skin that ``lit`` hides: completed, and by the mean colour of the seen skin."""
    hidden = (1 - lit) * skin
    flat = (truth * lit).sum((1, 2), keepdims=True) / max(float(lit.sum()), 1e-6)
    found = prior.complete(truth, lit)
    # What the seen part has beside the model goes on into the rest, as in the service.
    found = found + ((truth - found) * lit).sum((1, 2), keepdims=True) / max(float(lit.sum()), 1e-6)
    errors = (
        np.sqrt((np.square(one - truth) * hidden).sum() / max(3 * float(hidden.sum()), 1e-6)) for one in (found, flat)
    )
    completed, by_mean = (float(error) for error in errors)
    return completed, by_mean


def main(
    data: Annotated[Path, typer.Option(help="Folder of captures.")],
    output: Annotated[Path, typer.Option("-o", help="File to write.")] = FILE,
    count: Annotated[int, typer.Option(min=1, help="Components.")] = 12,
) -> None:
    """Choose the noise, write the prior.

    Raises:
        UsageError: there are too few captures.
    """
    wholes = Wholes(data / "train")
    wholes.refresh()
    if len(wholes.items) < FEWEST:
        raise UsageError(f"{data / 'train'} has {len(wholes.items)} captures; {FEWEST} are needed at least")
    maps = np.stack([log_albedo(item["albedo"].astype(np.uint8)) for item in wholes.items])
    cover = Cover()
    geometry = torch.stack([torch.from_numpy(item["geometry"].astype(np.float32)) for item in wholes.items])
    lit = cover(geometry, torch.Generator().manual_seed(1))[:, 0].numpy()

    def small(plane: Float) -> Float:
        return np.asarray(cv2.resize(plane, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA), np.float32)

    inside = small(geometry[0, -1].numpy())
    skin = small((cover.skin * (1 - cover.scalp) * (1 - cover.hidden)).numpy())
    seen = [small(one) for one in lit]
    found = {}
    for noise in NOISES:
        errors = [
            hidden_error(learnt(np.delete(maps, i, 0), inside, count, noise), maps[i], seen[i], skin)
            for i in range(len(maps))
        ]
        completed, by_mean = np.mean(errors, 0)
        typer.echo(f"noise {noise}: log albedo of hidden skin off by {completed:.3f}, by the seen mean {by_mean:.3f}")
        found[noise] = float(completed)
    # Photos leave light in the seen part, which captures do not: the most cautious of those that are as good.
    chosen = max(noise for noise, error in found.items() if error <= AS_GOOD * min(found.values()))
    prior = learnt(maps, inside, count, chosen)
    output.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        output, mean=prior.mean.astype(np.float16), components=prior.components.astype(np.float16),
        inside=inside.astype(np.float16), noise=np.array(chosen),
    )  # fmt: skip
    typer.echo(f"{output}: {len(prior.components)} components of {len(maps)} captures, noise {chosen}")


if __name__ == "__main__":
    typer.run(main)
