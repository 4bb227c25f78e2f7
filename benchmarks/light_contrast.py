"""What share of the light's local contrast is light: ``python -m benchmarks.light_contrast --data DIR``.

DIR is that of ``benchmarks.corrections``, whose rendered photos of real heads and skins these are. The albedo of each
is made anew with each of some settings of ``service.reflectance.corrections.light_contrast`` (share kept : width of
the surroundings); 1 keeps all. Printed is its PSNR after the best gain, dB, and in the last column what a photo has
with the setting that is best on the photos of all *other* skins: a number fitted to the very skins that it is judged
on would be worth nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from benchmarks.albedo import PHOTOS, OnDisk, albedo_of
from benchmarks.corrections.__main__ import CACHE
from benchmarks.corrections.photos import SITTINGS, photos
from benchmarks.corrections.rules import SIZE
from benchmarks.corrections.score import Judge
from benchmarks.shoot import data_folder
from models.tables import tell
from service.archive.avatar import Avatar
from service.options import Options
from service.pipeline import make_avatar
from service.reflectance import chart_light
from service.reflectance.corrections.light_contrast import LIGHT_CONTRAST, less_contrast
from service.reflectance.make import make_reflectance
from service.reflectance.subject import Subject
from service.runtime.networks import choose_engine
from service.stages import Unkept

MARK = ("<!-- light-contrast -->", "<!-- /light-contrast -->")
TRIED = "1:14,0.7:14,0.5:9,0.5:14,0.4:20,0.3:14"
Setting = tuple[float, float]


@contextmanager
def setting(kept: float, wide: float) -> Iterator[None]:
    """The correction with other numbers than the product's."""
    before = chart_light.ON_LIT_SKIN
    other = replace(LIGHT_CONTRAST, apply=lambda at: less_contrast(at.light, at.weight, kept, wide))
    chart_light.ON_LIT_SKIN = tuple(other if one is LIGHT_CONTRAST else one for one in before)
    try:
        yield
    finally:
        chart_light.ON_LIT_SKIN = before


def skin_of(name: str) -> str:
    """Whose skin a photo shows."""
    sitter = next(one.sitter for one in SITTINGS if one.name == name.split(" ")[0])
    return "scan" if sitter.shape == "scan" else sitter.skin


def scored(avatar: Avatar, judge: Judge, options: Options, tried: list[Setting]) -> dict[Setting, float]:
    """PSNR after the best gain with each setting."""
    subject = Subject.in_photo(avatar.head, avatar.fit, avatar.texture)
    engine = choose_engine(options.runtime, precision=options.level.precision)
    found = {}
    for kept, wide in tried:
        with setting(kept, wide):
            made = make_reflectance(avatar.texture.texture, subject, options.plan(), SIZE, engine)
        found[kept, wide] = judge.score(albedo_of(made)).best
    return found


def elsewhere(found: Mapping[str, Mapping[Setting, float]], name: str) -> float:
    """What a photo has with the setting that is best on other skins; NaN where there is none."""
    others = [one for who, one in found.items() if skin_of(who) != skin_of(name)]
    if not others:
        return float("nan")
    best = max(found[name], key=lambda chosen: float(np.mean([one[chosen] for one in others])))
    return found[name][best]


def table(found: Mapping[str, Mapping[Setting, float]]) -> list[str]:
    """Markdown."""
    tried = list(next(iter(found.values())))
    lines = ["| photo | skin | " + " | ".join(f"{kept:g} : {wide:g}" for kept, wide in tried) + " | by other skins |"]
    lines.append("|---" * (3 + len(tried)) + "|")
    rows = {name: [*one.values(), elsewhere(found, name)] for name, one in found.items()}
    lines += [f"| {who} | {skin_of(who)} | " + " | ".join(f"{v:.1f}" for v in row) + " |" for who, row in rows.items()]
    means = np.nanmean(list(rows.values()), 0)
    return [*lines, f"| **mean** ({len(rows)}) | | " + " | ".join(f"**{value:.2f}**" for value in means) + " |"]


def settings(text: str) -> list[Setting]:
    """``"0.5:14,1:14"`` -> pairs.

    Raises:
        BadParameter: a pair is not a share in [0, 1] and a width above 0.
    """
    try:
        pairs = [(float(kept), float(wide)) for kept, wide in (one.split(":") for one in text.split(","))]
    except ValueError as error:
        raise typer.BadParameter(f"tried is {text!r}; write pairs like {TRIED}") from error
    if any(not 0 <= kept <= 1 or not wide > 0 for kept, wide in pairs):
        raise typer.BadParameter(f"tried is {text!r}; shares have to be in [0, 1] and widths above 0")
    return pairs


def main(
    data: Annotated[Path | None, typer.Option(help="Folder of reference heads; else $AVATARME_BENCH_DATA.")] = None,
    cache: Annotated[Path, typer.Option(help="Folder that keeps what was rendered.")] = CACHE,
    wanted: Annotated[str, typer.Option("--photos", help="Names with commas between.")] = ",".join(PHOTOS),
    tried: Annotated[str, typer.Option(help="Pairs of share and width, with commas between.")] = TRIED,
    keep: Annotated[bool, typer.Option(help="Keep fits and textures beside the photos.")] = False,
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the table into.")] = None,
) -> None:
    """Print the table."""
    pairs, folder, found = settings(tried), data_folder(None if data is None else str(data)), {}
    cache.mkdir(parents=True, exist_ok=True)
    options = Options(maps=("diffuse_albedo",), quality="draft", size=SIZE, face="largest")
    for photo in photos(folder, cache, wanted.split(",")):
        stages = OnDisk(cache / "stages" / photo.name) if keep else Unkept()
        avatar = make_avatar(photo.data, replace(options, maps=("texture",)), stages=stages)
        found[photo.name] = scored(avatar, Judge.of(photo, avatar), options, pairs)
        typer.echo(f"{photo.name}: {max(found[photo.name].values()):.1f} dB at best", err=True)
    if not found:
        raise SystemExit(f"--photos names none of {', '.join(PHOTOS)}")
    tell("\n".join(table(found)), MARK, write)


if __name__ == "__main__":
    typer.run(main)
