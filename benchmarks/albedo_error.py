"""Whether the stated error of the albedo is right: ``python -m benchmarks.albedo_error --data DIR [--fit FILE]``.

DIR is that of ``benchmarks.corrections``, whose rendered photos these are. ``maps/albedo_error.png`` states the error
of log luminance that two texels in three stay within. Printed is the share of the pixels of seen skin, and of the
texels of skin that the photo does not show, whose error is smaller, photo by photo; beside it the median of what is
stated and of what it is, and their rank correlation: a constant would have none.

``--fit FILE`` first finds the weights (``service.reflectance.albedo.albedo_prior``) that do best on ``FITTED``, by
quantile regression, and writes them; the others are not used for it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import typer
from scipy.optimize import minimize
from scipy.stats import spearmanr

from benchmarks.albedo import PHOTOS, made
from benchmarks.corrections.__main__ import CACHE
from benchmarks.corrections.photos import photos
from benchmarks.corrections.score import Judge
from benchmarks.corrections.trial import SIZE
from benchmarks.metrics import at_chart
from benchmarks.shoot import data_folder
from models.tables import tell
from service.archive.avatar import Avatar
from service.arrays import Float32
from service.colour import LUMA, srgb_to_linear
from service.options import Options
from service.reflectance.albedo.albedo_prior import CLUES as WEIGHED
from service.reflectance.albedo.albedo_prior import LEAST, MOST, ErrorModel
from service.reflectance.albedo.diffuse_albedo import LIGHT_NETWORK, found_by
from service.reflectance.planes import Planes
from service.reflectance.subject import Subject
from service.reflectance.translate import resample
from service.runtime.network_registry import CLUES, GEOMETRY
from service.runtime.networks import choose_engine, open_network
from service.runtime.sessions import MODELS

Float = npt.NDArray[np.float64]

MARK = ("<!-- albedo-error -->", "<!-- /albedo-error -->")
FITTED = ("ffhq_soft", "hifi2_left", "hifi3_overhead", "dark_right", "scan_right", "beard_soft", "brows_left")
"""Photos that the weights are found on: each skin once, each light."""
SHARE = 0.68
TAKEN = 3000
"""Pixels and texels of each photo that the weights are found on."""
RIDGE = 1e-3
DARKEST = 1e-3
"""Linear luminance at which logarithms stop."""


@dataclass(frozen=True)
class Errors:
    """Of one photo.

    Attributes:
        clue: (K, N) of the pixels of seen skin, then of the texels of unseen skin.
        error: (N,) absolute error of log luminance.
        seen: how many of N are seen.
    """

    clue: Float
    error: Float
    seen: int

    def thinned(self, count: int) -> Errors:
        """At most ``count`` of each kind, evenly picked."""
        parts = (np.arange(self.seen), np.arange(self.seen, len(self.error)))
        chosen = [part[:: max(1, -(-len(part) // count))] for part in parts]
        index = np.concatenate(chosen)
        return Errors(self.clue[:, index], self.error[index], len(chosen[0]))


def clues_of(avatar: Avatar) -> Float32:
    """(K, h, w) what the product goes by."""
    subject = Subject.fitted(avatar.head, avatar.fit).wearing(avatar.texture)
    planes = Planes(SIZE)
    planes.add_coarse(GEOMETRY, subject.geometry)
    planes.add_coarse(CLUES, subject.clues)
    planes.add_codes("texture", resample(avatar.texture.legible.astype(np.uint16) * np.uint16(257), SIZE))
    options = Options(quality="draft")
    with open_network(LIGHT_NETWORK, choose_engine(options.runtime, precision=options.level.precision)) as network:
        return found_by(network, planes).clues


def errors_of(judge: Judge, albedo: Float, clue: Float32) -> Errors:
    """Of an albedo map (h, w, 3), sRGB-coded in [0, 1]."""

    def logs(coded: Float) -> Float:
        linear = srgb_to_linear(np.clip(coded, 0, 1).astype(np.float32)).astype(np.float64)
        return np.asarray(np.log(np.maximum(linear @ LUMA, DARKEST)))

    uv, truth = np.concatenate([judge.uv, judge.unseen_uv]), np.concatenate([judge.truth, judge.unseen_truth])
    planes = np.moveaxis(clue.astype(np.float64), 0, 2)
    error = np.abs(logs(at_chart(albedo, uv)) - logs(truth))
    return Errors(at_chart(planes, uv).T, error, len(judge.uv))


def fitted(found: Mapping[str, Errors]) -> Float:
    """(K,) weights whose stated errors ``SHARE`` of the pixels stay within; photos count alike."""
    parts = [one.thinned(TAKEN) for one in found.values()]
    clue = np.concatenate([one.clue for one in parts], 1)
    logs = np.log(np.clip(np.concatenate([one.error for one in parts]), LEAST / 2, MOST))
    weight = np.concatenate([np.full(len(one.error), 1 / len(one.error)) for one in parts]) / len(parts)

    def loss(weights: Float) -> tuple[float, Float]:
        over = logs - weights @ clue
        # The check function of quantile regression, rounded at its corner so that it has a gradient.
        soft = np.logaddexp(0, over / 0.05) * 0.05
        slope = SHARE - 1 + 1 / (1 + np.exp(-np.clip(over / 0.05, -50, 50)))
        plain = weights[1:]
        value = float((weight * ((SHARE - 1) * over + soft)).sum()) + RIDGE * float(plain @ plain)
        return value, -(clue @ (weight * slope)) + 2 * RIDGE * np.concatenate([[0.0], plain])

    # More of what makes an albedo uncertain never makes it surer.
    bounds = [(None, None), *[(0.0, None)] * (len(clue) - 1)]
    begin = np.concatenate([[float(np.quantile(logs, SHARE))], np.zeros(len(clue) - 1)])
    return np.asarray(minimize(loss, begin, jac=True, method="L-BFGS-B", bounds=bounds).x)


def row(name: str, one: Errors, model: ErrorModel) -> tuple[list[float], str]:
    """Shares within the stated error, of seen skin and of unseen; and a line of the table."""
    stated = model.stated(one.clue[:, None].astype(np.float32))[0].astype(np.float64)
    within = one.error <= stated
    parts = (slice(0, one.seen), slice(one.seen, None))
    shares = [float(within[part].mean()) if within[part].size else float("nan") for part in parts]
    rank = float(spearmanr(stated, one.error).statistic) if stated.std() > 0 else 0.0
    cells = [f"{value:.2f}" if np.isfinite(value) else "-" for value in shares]
    told = [*cells, f"{np.median(stated):.2f}", f"{np.median(one.error):.2f}", f"{rank:.2f}"]
    return shares, f"| {name} | {' | '.join(told)} |"


def table(found: Mapping[str, Errors], model: ErrorModel) -> list[str]:
    """Markdown."""
    lines = ["| photo | within: seen | unseen | median stated | median error | rank correlation |", "|---" * 6 + "|"]
    for used, title in ((True, "found on"), (False, "others")):
        group = {name: one for name, one in found.items() if (name in FITTED) == used}
        told = [row(name, one, model) for name, one in group.items()]
        lines += [line for _, line in told]
        if told:
            means = np.nanmean([shares for shares, _ in told], 0)
            lines.append(f"| **{title}** ({len(told)}) | **{means[0]:.2f}** | **{means[1]:.2f}** | | | |")
    return lines


def main(
    data: Annotated[Path | None, typer.Option(help="Folder of reference heads; else $AVATARME_BENCH_DATA.")] = None,
    cache: Annotated[Path, typer.Option(help="Folder that keeps what was rendered.")] = CACHE,
    wanted: Annotated[str, typer.Option("--photos", help="Names with commas between.")] = ",".join(PHOTOS),
    fit: Annotated[Path | None, typer.Option(help="JSON file to write weights into, found on these photos.")] = None,
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the table into.")] = None,
) -> None:
    """Print the table."""
    folder, found = data_folder(None if data is None else str(data)), {}
    cache.mkdir(parents=True, exist_ok=True)
    for photo in photos(folder, cache, wanted.split(",")):
        avatar, albedo = made(photo, MODELS)
        found[photo.name] = errors_of(Judge.of(photo, avatar), albedo, clues_of(avatar))
        typer.echo(f"{photo.name}: median {np.median(found[photo.name].error):.2f}", err=True)
    if not found:
        raise SystemExit(f"--photos names none of {', '.join(PHOTOS)}")
    if fit is not None:
        chosen = {name: one for name, one in found.items() if name in FITTED}
        if not chosen:
            raise SystemExit(f"--fit needs some of {', '.join(FITTED)} among the photos")
        weights = fitted(chosen)
        told = {name: round(float(value), 4) for name, value in zip(WEIGHED, weights, strict=True)}
        fit.write_text(json.dumps({"found_on": sorted(chosen), "weights": told}, indent=2) + "\n", "utf-8")
        model = ErrorModel.read(fit)
    else:
        model = ErrorModel.read()
    tell("\n".join(table(found, model)), MARK, write)


if __name__ == "__main__":
    typer.run(main)
