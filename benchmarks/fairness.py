"""The albedo's error by skin tone, all else equal.

``python -m benchmarks.fairness --data DIR [--write docs/fairness.md]``. One head with one skin in six tones, the
classes of the individual typology angle (Chardon 1991; Del Bino 2013), which go roughly with the types of Fitzpatrick,
in the same lights before the same camera, which meters the face. Each avatar is made by
``service.pipeline.make_avatar``. Only melanin differs: shape, pattern and light are the same, so what differs in error
is due to the tone. DIR is that of ``benchmarks.corrections``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import typer

from benchmarks.albedo import Found, judged, made, regions_of, typology_angle
from benchmarks.corrections.__main__ import CACHE
from benchmarks.corrections.photos import SEEDS, SIZE, Lens, Photo, develop, encoded, kept_exposure
from benchmarks.corrections.score import Judge
from benchmarks.corrections.sitters import Sitter, Studio
from benchmarks.heads import TexturedHead
from benchmarks.render import LAMPS, LIGHTS, Shot
from benchmarks.shoot import data_folder
from models.tables import tell
from service.colour import linear_to_srgb
from service.runtime.sessions import MODELS

Float = npt.NDArray[np.float64]

MARK = ("<!-- fairness -->", "<!-- /fairness -->")
CLASSES = (
    ("very light (I)", 60.0), ("light (II)", 48.0), ("intermediate (III)", 34.0), ("tan (IV)", 19.0),
    ("brown (V)", -10.0), ("dark (VI)", -48.0),
)  # fmt: skip
"""Class, Fitzpatrick's type that is nearest, and the typology angle in degrees of the sitter's mean colour."""

SITTER = Sitter(105)
"""A head of ICT-FaceKit with the skin of FFHQ-UV."""

MELANIN = np.array([0.88, 1.0, 1.1])
"""Absorption by channel over that in green (models.training.skins)."""
DEPTHS = np.linspace(-1.5, 4.0, 551)
"""Optical depths among which that of a class is looked for; below 0 there is less melanin than the skin has."""
WHITEST = 0.9
"""Linear albedo that no channel exceeds."""
FACE_M = 0.08
"""Radius of the part of the head about the middle of the face whose mean colour counts."""


def toned(colours: Float, angle: float, face: npt.NDArray[np.bool_]) -> Float:
    """(V, 3) linear colours with the melanin that brings the mean of ``face`` (V,) nearest to an angle in degrees."""
    mean = colours[face].mean(0)
    candidates = np.minimum(mean * np.exp(-DEPTHS[:, None] * MELANIN), WHITEST)
    coded = linear_to_srgb(candidates.astype(np.float32)).astype(np.float64)
    depth = DEPTHS[int(np.argmin([abs(typology_angle(colour) - angle) for colour in coded]))]
    return np.asarray(np.minimum(colours * np.exp(-depth * MELANIN), WHITEST))


def of_class(head: TexturedHead, name: str, angle: float) -> TexturedHead:
    """A head with its skin in the tone of a class."""
    face = np.linalg.norm(head.vertices - [0.0, -0.03, head.eyes[:, 2].mean()], axis=1) < FACE_M
    word = name.split(" (")[0].replace(" ", "_")
    return replace(head, name=f"{head.name}_{word}", colours=toned(head.colours, angle, face))


def photo_of(head: TexturedHead, light: str, cache: Path) -> Photo:
    """The photo of a head in a light; rendered where it is not kept."""
    shot, camera = Shot(8.0, light, 1.2, 18.0, SIZE, seed=SEEDS[0]), Lens()
    truth = kept_exposure(cache / f"tones_{head.name}_{light}.npz", head, shot)
    pixels = develop(truth.radiance, truth.skin, camera)
    return Photo(f"{head.name}_{light}", (), encoded(pixels, camera), truth, head, shot)


def table(found: Mapping[tuple[str, str], Found]) -> list[str]:
    """Markdown: a row for each class and light, then how far the means of the classes lie apart."""
    lines = ["| tone | light | angle | raw dB | best gain dB | Delta E | brightness, ours / truth | flat: Delta E |"]
    lines.append("|---" * 8 + "|")
    for (name, light), one in found.items():
        score = one.score
        told = f"{score.raw:.1f} | {score.best:.1f} | {score.delta_e:.1f} | {one.gain:.2f} | {one.flat.delta_e:.1f}"
        lines.append(f"| {name} | {light} | {one.angle:.0f} | {told} |")
    names = list(dict.fromkeys(name for name, _ in found))
    apart = []
    for number in ("raw", "best", "delta_e"):
        means = [
            np.mean([getattr(one.score, number) for key, one in found.items() if key[0] == name]) for name in names
        ]
        apart.append(f"{max(means) - min(means):.1f}")
    return [*lines, f"| **between best and worst tone** | | | {' | '.join(apart)} | | |"]


def main(
    data: Annotated[Path | None, typer.Option(help="Folder of reference heads; else $AVATARME_BENCH_DATA.")] = None,
    cache: Annotated[Path, typer.Option(help="Folder that keeps what was rendered.")] = CACHE,
    lights: Annotated[str, typer.Option(help="With commas between.")] = "soft,left",
    models: Annotated[Path, typer.Option(help="Folder of networks to ask.")] = MODELS,
    tones: Annotated[str, typer.Option(help="Numbers of the classes, I to VI as 1 to 6.")] = "1,2,3,4,5,6",
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the table into.")] = None,
) -> None:
    """Print the table."""
    wanted = list(dict.fromkeys(lights.split(",")))
    if not set(wanted) <= {*LIGHTS, *LAMPS}:
        raise typer.BadParameter(f"lights is {lights!r}; there are {', '.join((*LIGHTS, *LAMPS))}")
    if not set(tones.split(",")) <= {str(n + 1) for n in range(len(CLASSES))}:
        raise typer.BadParameter(f"tones is {tones!r}; give numbers from 1 to {len(CLASSES)} with commas between")
    cache.mkdir(parents=True, exist_ok=True)
    head, planes = Studio(data_folder(None if data is None else str(data)), cache).head(SITTER), regions_of()
    found = {}
    for name, angle in (CLASSES[int(number) - 1] for number in tones.split(",")):
        for light in wanted:
            photo = photo_of(of_class(head, name, angle), light, cache)
            avatar, albedo = made(photo, models)
            found[name, light] = judged(Judge.of(photo, avatar), albedo, planes)
            typer.echo(f"{photo.name}: {found[name, light].score.raw:.1f} dB", err=True)
    tell("\n".join(table(found)), MARK, write)


if __name__ == "__main__":
    typer.run(main)
