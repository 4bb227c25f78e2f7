"""Learns the Gaussian of whole albedo maps: ``python -m models.training.albedo_prior --data DIR``.

Principal components of log albedo over the charts of captures and their mirror images, for
``service.reflectance.albedo.albedo_prior``. Beards of all kinds are painted over copies of the charts
(``models.training.facial_hair``), so one that ends at the border of what a photo shows goes on beyond it. How far the
components are trusted is what completes other subjects best: captures are left out part by part, half hidden as photos
hide them, and completed; the command prints the error on hidden skin, and on that of it where a painted beard grows,
beside that of the mean colour of the seen skin. Then the same of charts without a beard alone.

Captures have lids as bright as cheeks, and real skin has not: the mean of what ``models.training.paint`` paints on lids
is added at the end, as the context learns from painted charts, too. ``--unpainted FILE`` adds it to a prior without,
and learns nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import numpy.typing as npt
import torch
import typer

from models.lightstage.skin.subject import Subject
from models.training.cover import Cover
from models.training.facial_hair import Barber
from models.training.paint import MARKS, Painter
from models.training.store import Arrays, Wholes
from service.colour import srgb_to_linear
from service.errors import UsageError
from service.geometry.chart import nearest_inside
from service.reflectance.albedo.albedo_prior import BARE, FILE, AlbedoPrior

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
SHORN = 0.05
"""Share of the scalp from which on a texel has stubble."""
FEWEST = 4
"""Fewest captures by which some can be left out."""
FOLDS = 8
"""Parts of the captures that are left out in turn, with all copies of their charts."""
COPIES = 2
"""Of each chart with hair painted by chance; half of them have a beard."""
BEARDED = 0.3
"""Share of a texel covered by a painted beard from which its error counts as that of a beard."""


def log_albedo(coded: npt.NDArray[np.uint8]) -> Float:
    """(3, HEIGHT, WIDTH) natural logarithm of the means of linear albedo of a capture's (3, h, w) sRGB codes."""
    linear = srgb_to_linear(coded.astype(np.float32) / np.float32(255))
    small = [cv2.resize(plane, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA) for plane in linear]
    return np.log(np.maximum(np.stack(small), DARKEST)).astype(np.float32)


def without_stubble(maps: Float, scalp: Float, inside: Float) -> Float:
    """Maps (..., h, w) whose scalp goes on smoothly from the skin around, as captures are shorn and stubble is grey.

    A head that wears hair has the shadow of its roots besides, and a bald one has skin.

    Args:
        maps: log albedo, or components of it, as this is linear.
        scalp: (h, w) in [0, 1].
        inside: (h, w) in [0, 1], islands of the chart.
    """
    from scipy.sparse import csr_matrix, eye
    from scipy.sparse.linalg import splu

    place = np.arange(scalp.size).reshape(scalp.shape)
    pairs = (place[:, :-1], place[:, 1:]), (place[:-1], place[1:])
    sides = np.concatenate([np.stack([one.ravel(), other.ravel()], 1) for one, other in pairs])
    sides = sides[(inside.ravel()[sides] > 0.5).all(1)]
    near = csr_matrix((np.ones(len(sides)), sides.T), (scalp.size,) * 2)
    near = near + near.T
    hidden = (scalp.ravel() > SHORN) & (np.asarray(near.sum(1)).ravel() > 0)
    pull = csr_matrix((np.asarray(near.sum(1)).ravel(), (place.ravel(),) * 2)) - near
    system = pull.multiply(hidden[:, None]) + eye(scalp.size).multiply((~hidden)[:, None]) + 1e-9 * eye(scalp.size)
    flat = maps.reshape(-1, scalp.size).astype(np.float64)
    filled = splu(system.tocsc()).solve((flat * ~hidden).T).T[:, nearest_inside(inside > 0.5).ravel()]
    return np.asarray(filled.reshape(maps.shape), np.float32)


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


def hidden_error(prior: AlbedoPrior, truth: Float, lit: Float, where: Float) -> tuple[float, float]:
    """Root mean square of log albedo where ``lit`` hides a region: completed, and by the mean colour of the seen skin.

    NaN where nothing of the region is hidden.

    Args:
        prior: that completes.
        truth: (3, h, w) log albedo.
        lit: (h, w) in [0, 1], what is seen.
        where: (h, w) in [0, 1], the region.
    """
    hidden = (1 - lit) * where
    if float(hidden.sum()) < 1:
        return float("nan"), float("nan")
    flat = (truth * lit).sum((1, 2), keepdims=True) / max(float(lit.sum()), 1e-6)
    found = prior.complete(truth, lit)
    # What the seen part has beside the model goes on into the rest, as in the service.
    found = found + ((truth - found) * lit).sum((1, 2), keepdims=True) / max(float(lit.sum()), 1e-6)
    errors = (
        np.sqrt((np.square(one - truth) * hidden).sum() / max(3 * float(hidden.sum()), 1e-6)) for one in (found, flat)
    )
    completed, by_mean = (float(error) for error in errors)
    return completed, by_mean


@dataclass(frozen=True)
class Charts:
    """Whole charts, as they are and with painted hair.

    Attributes:
        maps: (N, 3, h, w) log albedo.
        of: (N,) the capture that each is of.
        seen: (N, h, w) in [0, 1], what a photo of it would show.
        beard: (N, h, w) in [0, 1], share of the skin that a painted beard covers.
    """

    maps: Float
    of: npt.NDArray[np.int64]
    seen: Float
    beard: Float

    @classmethod
    def drawn(cls, items: Sequence[Arrays], cover: Cover, seed: int = 1) -> Charts:
        """Of captures (``models.training.store.Wholes``)."""
        barber, generator = Barber(), torch.Generator().manual_seed(seed)
        maps, of, seen, beard = [], [], [], []
        for index, item in enumerate(items):
            coded = torch.from_numpy(item["albedo"].astype(np.float32) / np.float32(255))[None]
            geometry = torch.from_numpy(item["geometry"].astype(np.float32))[None]
            for copy in range(1 + COPIES):
                painted, hair = coded, torch.zeros_like(coded[:, :1])
                if copy:
                    _, painted, hair = barber(coded, coded, generator)
                maps.append(log_albedo(np.rint(painted[0].numpy() * 255).astype(np.uint8)))
                seen.append(small(cover(geometry, generator)[0, 0].numpy()))
                beard.append(small(hair[0, 0].numpy()))
                of.append(index)
        return cls(np.stack(maps), np.array(of), np.stack(seen), np.stack(beard))

    def only(self, chosen: npt.NDArray[np.bool_]) -> Charts:
        """Some of them, (N,)."""
        return Charts(self.maps[chosen], self.of[chosen], self.seen[chosen], self.beard[chosen])


DRAWS = 1280
"""Of marks, whose mean is that of all."""


def with_lids(mean: Float, seed: int = 5) -> Float:
    """(3, HEIGHT, WIDTH) mean log albedo of heads with lids as dark as those of real skin."""
    lids = tuple(mark for mark in MARKS if all("eyelid" in region for region in mark.regions))
    painter, generator = Painter(lids), torch.Generator().manual_seed(seed)
    density = sum(painter.density(32, generator).mean(0) for _ in range(DRAWS // 32)) / (DRAWS // 32)
    return np.asarray(mean - np.stack([small(plane.numpy()) for plane in density]), np.float32)


def small(plane: Float) -> Float:
    """(HEIGHT, WIDTH) means of a plane."""
    return np.asarray(cv2.resize(plane, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA), np.float32)


def main(
    data: Annotated[Path | None, typer.Option(help="Folder of captures.")] = None,
    output: Annotated[Path, typer.Option("-o", help="File to write.")] = FILE,
    count: Annotated[int, typer.Option(min=1, help="Components.")] = 32,
    unpainted: Annotated[Path | None, typer.Option(help="Prior with lids as bright as captures have them.")] = None,
) -> None:
    """Learn both priors, write them.

    Raises:
        UsageError: there are too few captures, or too few without a beard, or not one of both sources is named.
    """
    arrays: dict[str, npt.NDArray[np.generic]]
    if data is not None and unpainted is None:
        arrays = of_captures(data, count)
    elif unpainted is not None and data is None:
        with np.load(unpainted, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    else:
        raise UsageError("a prior is learnt from --data or begins as --unpainted: name one of both")
    for kind in ("", BARE):
        arrays[kind + "mean"] = with_lids(arrays[kind + "mean"].astype(np.float32)).astype(np.float16)
    output.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(output, **arrays)  # type: ignore[arg-type]
    typer.echo(f"{output}: of {data or unpainted}")


def of_captures(data: Path, count: int) -> dict[str, npt.NDArray[np.generic]]:
    """The arrays of both priors as captures are.

    Raises:
        UsageError: there are too few captures, or too few without a beard.
    """
    wholes = Wholes(data / "train")
    wholes.refresh()
    if len(wholes.items) < FEWEST:
        raise UsageError(f"{data / 'train'} has {len(wholes.items)} captures; {FEWEST} are needed at least")
    cover = Cover()
    charts = Charts.drawn(wholes.items, cover)
    inside = small(wholes.items[0]["geometry"][-1].astype(np.float32))
    skin = small((cover.skin * (1 - cover.scalp) * (1 - cover.hidden)).numpy())
    charts = replace(charts, maps=without_stubble(charts.maps, small(cover.scalp.numpy()), inside))
    own = [Subject.sample(int(one["seed"])).hair.beard_density > 0.0 for one in wholes.items]
    bare = (charts.beard.max((1, 2)) == 0) & ~np.array(own)[charts.of]
    if bare.sum() < FEWEST:
        raise UsageError(f"{data / 'train'} has {bare.sum()} charts without a beard; {FEWEST} are needed at least")
    arrays: dict[str, npt.NDArray[np.generic]] = {"inside": inside.astype(np.float16)}
    for kind, chosen in (("", charts), (BARE, charts.only(bare))):
        typer.echo(f"{len(chosen.of)} charts {'without a beard' if kind else 'of all kinds'}")
        prior = best(chosen, inside, skin, count)
        for name in ("mean", "components"):
            arrays[kind + name] = getattr(prior, name).astype(np.float16)
        arrays[kind + "noise"] = np.array(prior.noise)
    return arrays


def best(charts: Charts, inside: Float, skin: Float, count: int) -> AlbedoPrior:
    """The prior of charts with the noise by which others are completed best; prints the errors."""
    errors: dict[float, list[tuple[float, ...]]] = {noise: [] for noise in NOISES}
    for fold in range(FOLDS):
        left_out = charts.of % FOLDS == fold
        if not left_out.any():
            continue
        prior = learnt(charts.maps[~left_out], inside, count, NOISES[0])
        for noise, one in product(NOISES, np.flatnonzero(left_out)):
            places = (skin, skin * (charts.beard[one] > BEARDED))
            tried = [hidden_error(replace(prior, noise=noise), charts.maps[one], charts.seen[one], p) for p in places]
            errors[noise].append((*tried[0], *tried[1]))
    found = {}
    for noise, rows in errors.items():
        known = [[value for value in column if np.isfinite(value)] for column in zip(*rows, strict=True)]
        completed, by_mean, beard, beard_by_mean = (float(np.mean(c)) if c else float("nan") for c in known)
        typer.echo(
            f"noise {noise}: log albedo of hidden skin off by {completed:.3f}, by the seen mean {by_mean:.3f}; "
            f"under painted beards {beard:.3f}, {beard_by_mean:.3f}"
        )
        found[noise] = completed
    # Photos leave light in the seen part, which captures do not: the most cautious of those that are as good.
    chosen = max(noise for noise, error in found.items() if error <= AS_GOOD * min(found.values()))
    prior = learnt(charts.maps, inside, count, chosen)
    typer.echo(f"{len(prior.components)} components, noise {chosen}")
    return prior


if __name__ == "__main__":
    typer.run(main)
