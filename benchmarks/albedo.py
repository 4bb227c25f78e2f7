"""What is left of beards, brows and light in the albedo: ``python -m benchmarks.albedo --data DIR [--write FILE]``.

DIR is that of ``benchmarks.corrections``, whose rendered photos of real heads and skins these are, with known albedo.
Each avatar is made by ``service.pipeline.make_avatar``. Two tables:

- how far the albedo of the skin that a photo shows is from the truth: PSNR of sRGB-coded values as they are (*raw*),
  after the one gain of linear values that fits best, and CIEDE2000; after that gain on the face's skin that the photo
  does not show (*unseen*); beside it one flat colour, the true mean; with means by skin tone.
- how bright a region is over the cheeks, ours over the truth's: 1 is right. Beards and brows that are taken for shade
  come out above 1, highlights that stay on the ridge of the nose likewise, shade that stays below.

``--models FOLDER`` asks the networks of another folder instead, to compare weights before they are exchanged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np
import numpy.typing as npt
import typer

from benchmarks.corrections.__main__ import CACHE, known_mean
from benchmarks.corrections.photos import Photo, photos
from benchmarks.corrections.score import Judge, Score
from benchmarks.corrections.trial import SIZE
from benchmarks.metrics import at_chart
from benchmarks.shoot import data_folder
from models.networks.context import HEIGHT, WIDTH
from models.tables import tell
from models.training.facial_hair import Places
from models.training.regions import region_planes
from service.archive.avatar import Avatar
from service.colour import FULL_CODE, LUMA, srgb_to_linear
from service.options import Options
from service.pipeline import make_avatar
from service.reflectance.reflectance import make_reflectance
from service.reflectance.reflectance_maps import Reflectance
from service.reflectance.subject import Subject
from service.runtime.networks import choose_engine
from service.runtime.sessions import MODELS

T = TypeVar("T")
Float = npt.NDArray[np.float64]

MARK = ("<!-- albedo -->", "<!-- /albedo -->")
PHOTOS = (
    "ffhq_soft", "ffhq_left", "hifi2_left", "hifi3_overhead", "dark_soft", "dark_right", "scan_right", "beard_soft",
    "beard_harsh", "brows_soft", "brows_left", "smile_soft", "shut_overhead",
)  # fmt: skip
"""Of ``benchmarks.corrections.photos``: four skins and a scan, a dark tone, beards, brows, a smile and shut eyes, in
four lights."""

TONES = (("dark", -90.0, 10.0), ("tan", 10.0, 41.0), ("light", 41.0, 90.0))
"""By the typology angle (Chardon 1991) of the true mean colour, degrees."""

LEAST = 0.5
"""Weight of a region on a texel from which a pixel belongs to it."""
FEWEST = 40
"""Fewest pixels of a region that a photo has to show."""


@dataclass(frozen=True)
class Found:
    """Of one photo.

    Attributes:
        score, flat: of the albedo, and of one colour, the true mean.
        regions: brightness over the cheeks', ours over the truth's, by region; those that the photo shows.
        angle: typology angle of the true mean colour, degrees.
        gain: mean linear luminance, ours over the truth's.
    """

    score: Score
    flat: Score
    regions: Mapping[str, float]
    angle: float
    gain: float


def regions_of() -> dict[str, Float]:
    """Weights in [0, 1] of regions on the context's chart (h, w)."""
    brows, nose, cheeks, lids = region_planes(
        ("brow_left", "brow_right"), ("nose",), ("cheek_left", "cheek_right"), ("eyelid_left", "eyelid_right")
    ).numpy()
    places = Places.of_head()
    x = np.abs(np.arange(WIDTH) + 0.5 - WIDTH / 2)
    ridge = nose * (x < 0.01 * WIDTH)[None]
    ridge[np.arange(HEIGHT) > np.flatnonzero(nose.max(1) > LEAST).max() - 0.02 * HEIGHT] = 0  # nostrils
    found = {
        "cheeks": cheeks, "brows": brows, "moustache": places.moustache.numpy(), "chin": places.chin.numpy(),
        "nose ridge": ridge, "lids": lids,
    }  # fmt: skip
    return {name: np.asarray(plane, np.float64) for name, plane in found.items()}


def luminance(coded: Float) -> Float:
    """(N,) linear luminance of (N, 3) sRGB-coded colours."""
    return np.asarray(srgb_to_linear(np.clip(coded, 0, 1).astype(np.float32)).astype(np.float64) @ LUMA)


def brightness(albedo: Float, weights: Mapping[str, Float]) -> dict[str, float]:
    """Mean linear luminance of each region over that of the cheeks.

    Args:
        albedo: (N, 3) sRGB-coded in [0, 1].
        weights: (N,) of each region; those with fewer than ``FEWEST`` pixels are left out. "cheeks" has to be there.
    """
    bright = luminance(albedo)
    mean = {name: bright[w > LEAST].mean() for name, w in weights.items() if (w > LEAST).sum() >= FEWEST}
    cheeks = mean.pop("cheeks", float("nan"))
    return {name: float(value / max(cheeks, 1e-6)) for name, value in mean.items()}


def typology_angle(coded: Float) -> float:
    """Degrees of a colour (3,) sRGB-coded in [0, 1]: atan((L* - 50) / b*)."""
    from skimage.color import rgb2lab

    lightness, _, yellow = rgb2lab(coded[None, None])[0, 0]
    return float(np.degrees(np.arctan2(lightness - 50.0, max(yellow, 1e-6))))


def judged(judge: Judge, albedo: npt.NDArray[np.floating], planes: Mapping[str, Float]) -> Found:
    """Of an albedo map (h, w, 3), sRGB-coded in [0, 1], and regions on the chart (h, w)."""
    weights = {name: at_chart(plane[..., None], judge.uv)[:, 0] for name, plane in planes.items()}
    found = at_chart(albedo, judge.uv)
    ours, truth = (brightness(colours, weights) for colours in (found, judge.truth))
    gain = float(luminance(found).mean() / max(luminance(judge.truth).mean(), 1e-6))
    regions = {name: ours[name] / max(truth[name], 1e-6) for name in truth}
    return Found(judge.score(albedo), judge.flat(), regions, typology_angle(judge.truth.mean(0)), gain)


def albedo_of(made: Reflectance | None) -> npt.NDArray[np.float64]:
    """The map as floats in [0, 1].

    Raises:
        ValueError: it was not made.
    """
    if made is None or made.diffuse_albedo is None:
        raise ValueError("an avatar of this benchmark has to have the diffuse albedo")
    return np.asarray(made.diffuse_albedo / FULL_CODE, np.float64)


def made(photo: Photo, models: Path) -> tuple[Avatar, npt.NDArray[np.float64]]:
    """The avatar, and its albedo by the networks of a folder."""
    options = Options(maps=("diffuse_albedo",), quality="draft", size=SIZE, face="largest")
    if models == MODELS:
        avatar = make_avatar(photo.data, options)
        return avatar, albedo_of(avatar.reflectance)
    avatar = make_avatar(photo.data, replace(options, maps=("texture",)))
    subject = Subject.fitted(avatar.head, avatar.fit).wearing(avatar.texture)
    engine = choose_engine(options.runtime, precision=options.level.precision, folder=models)
    return avatar, albedo_of(make_reflectance(avatar.texture.legible, subject, options.plan(), SIZE, engine))


def tone_of(angle: float) -> str:
    """Class of a typology angle in degrees."""
    return next(name for name, low, high in TONES if low <= angle < high or (high == 90.0 and angle >= high))


def tables(found: Mapping[str, Found]) -> list[str]:
    """Markdown."""
    lines = [
        "| photo | tone | raw dB | best gain | Delta E | unseen | flat: raw dB | best gain | Delta E | unseen |",
        "|---" * 10 + "|",
    ]

    def numbers(one: Found) -> list[float]:
        return [value for s in (one.score, one.flat) for value in (s.raw, s.best, s.delta_e, s.unseen)]

    lines += [f"| {name} | {tone_of(one.angle)} | {_row(numbers(one))} |" for name, one in found.items()]
    for tone in (*(name for name, *_ in TONES), "all"):
        chosen = [numbers(one) for one in found.values() if tone in (tone_of(one.angle), "all")]
        if chosen:
            means = [known_mean(column) for column in zip(*chosen, strict=True)]
            lines.append(f"| **mean** | {tone} ({len(chosen)}) | {_row(means)} |")
    names = [name for name in regions_of() if name != "cheeks"]
    title = "| brightness over the cheeks', ours / truth | " + " | ".join(names) + " |"
    lines += ["", title, "|---" * (len(names) + 1) + "|"]
    for photo, one in found.items():
        lines.append(f"| {photo} | " + " | ".join(_ratio(one.regions.get(name)) for name in names) + " |")
    off = [_within([one.regions[name] for one in found.values() if name in one.regions]) for name in names]
    return [*lines, "| mean of abs(log) | " + " | ".join(off) + " |"]


def _row(values: Sequence[float]) -> str:
    return " | ".join(f"{value:.1f}" if np.isfinite(value) else "-" for value in values)


def _ratio(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _within(ratios: Sequence[float]) -> str:
    return f"**{np.mean(np.abs(np.log(np.maximum(ratios, 1e-3)))):.3f}**" if ratios else "-"


def main(
    data: Annotated[Path | None, typer.Option(help="Folder of reference heads; else $AVATARME_BENCH_DATA.")] = None,
    cache: Annotated[Path, typer.Option(help="Folder that keeps what was rendered.")] = CACHE,
    models: Annotated[Path, typer.Option(help="Folder of networks to ask.")] = MODELS,
    wanted: Annotated[str, typer.Option("--photos", help="Names with commas between.")] = ",".join(PHOTOS),
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the tables into.")] = None,
) -> None:
    """Print the tables."""
    folder, planes, found = data_folder(None if data is None else str(data)), regions_of(), {}
    cache.mkdir(parents=True, exist_ok=True)
    for photo in photos(folder, cache, wanted.split(",")):
        avatar, albedo = made(photo, models)
        found[photo.name] = judged(Judge.of(photo, avatar), albedo, planes)
        typer.echo(f"{photo.name}: {found[photo.name].score.raw:.1f} dB", err=True)
    if not found:
        raise SystemExit(f"--photos names none of {', '.join(PHOTOS)}")
    tell("\n".join(tables(found)), MARK, write)


if __name__ == "__main__":
    typer.run(main)
