"""The same heads in several lights: ``python -m benchmarks.light_spread --data DIR [--write docs/reflectance.md]``.

DIR holds ``ict_facekit_head.npz``, ``ffhq_uv_head/``, ``hifi3d_uv/`` and ``lee_perry_smith/``, which no training has
seen. Heads are of four kinds: those with a carried skin, the scan, and held-out subjects of the light stage
(``benchmarks.heads``), and three further real skins. Mitsuba takes a photo of each head in each light; the program
makes a diffuse albedo of each photo. Two questions:

- How far is it from the true albedo? PSNR of sRGB-coded skin over the pixels of the photo where both heads show the
  face, and the same after the one gain of linear values that fits best: how dark a skin is, and how bright its light,
  is all but impossible to tell from a photo. Beside it one flat colour, the true mean; and means of each head over its
  lights.
- How much of the light is left in it? Root mean square over texels of the standard deviation over lights, beside that
  over heads of the mean over lights. All heads share one chart; texels count that every photo shows.

Beside both stands the texture itself, with the photo's light in it. ``--photos 3`` makes each avatar of three photos,
the further ones from the sides, each in the next of the lights; it is compared in the first. Printed with it: how much
of the face is seen. Photos are kept in ``--out`` and not taken again.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import typer

from benchmarks.corrections.sitters import Sitter, Studio
from benchmarks.heads import TexturedHead
from benchmarks.metrics import View, face_region
from benchmarks.render import FURTHER_LAMPS, LAMPS, Shot, take_once
from benchmarks.shoot import data_folder
from benchmarks.subjects import KINDS as SUBJECTS
from models.tables import tell
from models.training.regions import region_planes
from service.colour import linear_to_srgb, srgb_to_linear
from service.image_filters import shrunk

Float = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

MARK = ("<!-- light-spread -->", "<!-- /light-spread -->")
HIFI3D = (Sitter(106, "hifi3d 1"), Sitter(108, "hifi3d 2"), Sitter(109, "hifi3d 3"))
"""Three real skins on three shapes of ICT-FaceKit."""


def hifi3d(data: Path, out: Path) -> list[TexturedHead]:
    """The heads of ``HIFI3D``."""
    studio = Studio(data, out)
    return [replace(studio.head(one), name=one.skin.replace(" ", "")) for one in HIFI3D]


KINDS = {**SUBJECTS, "hifi3d": hifi3d}
"""Kinds of heads: (folder of reference heads, folder that keeps what was made) -> heads."""

LIGHTS = ("soft", *LAMPS, "harsh", *FURTHER_LAMPS)
YAWS = (8.0, -35.0, 35.0)
"""Degrees, of the photos of one avatar; the first is the most frontal, so that the program takes it for the best."""
SIZE = 512
COMPARED_WIDTH = 384
"""Maps are averaged to this width before lights are compared: fits differ by a texel or two of the finer map."""

NEAR_M = 0.004
"""A pixel shows skin where the nearest vertex of the head's own mesh is not further."""

ALL = "all"

SEEN = 160
"""Confidence from which on a texel counts as seen."""


@dataclass(frozen=True)
class Run:
    """One photo: PSNR in dB of albedo, a flat colour and texture, raw and after the best gain; maps, sRGB in [0, 1]."""

    albedo: tuple[float, float]
    flat: tuple[float, float]
    texture: tuple[float, float]
    maps: Mapping[str, Float]
    seen: Mask


def photo_of(head: TexturedHead, light: str, out: Path, yaw: float = YAWS[0]) -> Path:
    """Path, without ending, of the photo of a head in a light; taken where it is not there."""
    path = out / (f"spread_{head.name}_{light}" + (f"_{yaw:.0f}" if yaw != YAWS[0] else ""))
    take_once(head, Shot(yaw, light, 1.2, 18.0, SIZE), path)
    return path


def true_albedo(head: TexturedHead, position: Float, mask: Mask) -> tuple[Float, Mask]:
    """(H, W, 3) linear albedo of each pixel, the mean of the three nearest vertices'; and which pixels show skin."""
    albedo, near = np.zeros((*mask.shape, 3)), np.zeros(mask.shape, bool)
    albedo[mask], distance = head.colours_at(position[mask])
    eyes = np.linalg.norm(position[mask][:, None] - head.eyes, axis=2).min(1) < 1.05 * head.eye_radius
    near[mask] = (distance < NEAR_M) & ~eyes
    return albedo, near


def psnr(found: Float, truth: Float) -> tuple[float, float]:
    """PSNR in dB of sRGB-coded colours (N, 3) in [0, 1]: as they are, and after the best gain of linear values.

    Raises:
        ValueError: there is nothing to compare.
    """
    if not len(found):
        raise ValueError("the fitted head and the true one share no pixel of skin")
    one, other = (
        srgb_to_linear(np.clip(values, 0, 1).astype(np.float32)).astype(np.float64) for values in (found, truth)
    )
    gain = float((one * other).sum() / max(float((one * one).sum()), 1e-12))
    scaled = linear_to_srgb(np.clip(gain * one, 0, 1).astype(np.float32)).astype(np.float64)
    errors = (float(np.square(values - truth).mean()) for values in (found, scaled))
    raw, best = (-10 * float(np.log10(max(error, 1e-10))) for error in errors)
    return raw, best


def run(head: TexturedHead, lights: Sequence[str], out: Path, quality: str) -> Run:
    """Take a photo in each light, make the albedo of all, compare it in the first.

    Raises:
        AvatarError: as ``service.pipeline.make_avatar``.
    """
    from service.options import Options
    from service.pipeline import make_avatar

    paths = [photo_of(head, *one) for one in zip(lights, itertools.repeat(out), YAWS, strict=False)]
    options = Options(maps=("diffuse_albedo", "texture", "confidence"), quality=quality, face="largest")  # type: ignore[arg-type]
    avatar = make_avatar([Path(f"{path}.png").read_bytes() for path in paths], options)
    assert avatar.reflectance is not None and avatar.reflectance.diffuse_albedo is not None  # noqa: S101 - asked for
    maps = {"albedo": avatar.reflectance.diffuse_albedo / 65535.0, "texture": avatar.texture.texture / 255.0}
    with np.load(f"{paths[0]}.npz") as truth:
        position, normal = truth["position"].astype(np.float64), truth["normal"].astype(np.float64)
        albedo, skin = true_albedo(head, position, truth["mask"])
        region = face_region(position, normal, head.eyes, float(truth["yaw"]))
    view = View.of(avatar.fit, avatar.head, (skin.shape[0], skin.shape[1]))
    ours, texture = (view.of_map(maps[name]) for name in ("albedo", "texture"))
    face = skin & view.skin & region
    coded = linear_to_srgb(albedo[face].astype(np.float32)).astype(np.float64)
    size = (COMPARED_WIDTH, COMPARED_WIDTH * 2 // 3)
    small = {k: shrunk(v, size).astype(np.float64) for k, v in maps.items()}
    seen = shrunk(avatar.texture.confidence, size) >= SEEN
    flat = np.broadcast_to(coded.mean(0), coded.shape)
    return Run(psnr(ours[face], coded), psnr(flat, coded), psnr(texture[face], coded), small, seen)


@dataclass(frozen=True)
class Spread:
    """Standard deviations of a map, sRGB in [0, 1], over texels that all photos show.

    Attributes:
        over_lights: by kind of head, and of all as ``ALL``: root mean square over texels and heads.
        over_heads: of the means over lights; NaN where there is one head.
    """

    over_lights: Mapping[str, float]
    over_heads: float

    @classmethod
    def of(cls, runs: Mapping[tuple[str, str], Run], kinds: Mapping[str, str], name: str) -> Spread:
        """Of one map of all runs; ``kinds`` has the kind of each head."""
        common = seen_by_all(runs)
        values = {
            who: np.stack([one.maps[name][common] for (he, _), one in runs.items() if he == who]) for who in kinds
        }
        variance = {who: float(part.var(0, ddof=1).mean()) for who, part in values.items()}
        groups = {kind: [variance[who] for who in kinds if kinds[who] == kind] for kind in kinds.values()}
        over_lights = {
            kind: float(np.sqrt(np.mean(group))) for kind, group in (groups | {ALL: [*variance.values()]}).items()
        }
        means = np.stack([part.mean(0) for part in values.values()])
        return cls(over_lights, float(np.sqrt(means.var(0, ddof=1).mean())) if len(means) > 1 else float("nan"))


def seen_by_all(runs: Mapping[tuple[str, str], Run]) -> Mask:
    """Texels that every photo shows."""
    return np.asarray(np.logical_and.reduce([one.seen for one in runs.values()]))


def table(runs: Mapping[tuple[str, str], Run], kinds: Mapping[str, str], quality: str) -> list[str]:
    """Markdown; ``kinds`` has the kind of each head."""
    lines = ["| kind | head | light | albedo dB | best gain | flat: best gain | texture itself dB | best gain |"]
    lines.append("|---" * 8 + "|")

    def numbers(one: Run) -> tuple[float, ...]:
        return (*one.albedo, one.flat[1], *one.texture)

    for (who, light), one in runs.items():
        lines.append(f"| {kinds[who]} | {who} | {light} | {' | '.join(f'{value:.1f}' for value in numbers(one))} |")
    for head, kind in kinds.items():
        told = np.mean([numbers(one) for (who, _), one in runs.items() if who == head], 0)
        lines.append(f"| {kind} | {head} | mean | {' | '.join(f'**{value:.1f}**' for value in told)} |")
    named = list(dict.fromkeys(kinds.values()))
    for kind in (*named, ALL):
        told = np.mean([numbers(one) for (who, _), one in runs.items() if kind in (kinds[who], ALL)], 0)
        lines.append(f"| {kind} | all | mean | {' | '.join(f'**{value:.1f}**' for value in told)} |")
    title = f"| standard deviation (sRGB, 255 = 1) | over lights: {' | '.join((*named, ALL))} | over heads | ratio |"
    lines += ["", title, "|---" * (4 + len(named)) + "|"]
    for name in ("albedo", "texture"):
        found = Spread.of(runs, kinds, name)
        lights = " | ".join(f"{255 * found.over_lights[kind]:.1f}" for kind in (*named, ALL))
        ratio = found.over_lights[ALL] / max(found.over_heads, 1e-9)
        people = "- | -" if np.isnan(found.over_heads) else f"{255 * found.over_heads:.1f} | {ratio:.2f}"
        lines.append(f"| {name} | {lights} | {people} |")
    texels = f"{seen_by_all(runs).sum()} texels of {COMPARED_WIDTH} x {COMPARED_WIDTH * 2 // 3} are seen in all photos"
    face = shrunk(region_planes(("face",)).numpy()[0], (COMPARED_WIDTH, COMPARED_WIDTH * 2 // 3)) > 0.5
    shown = [one.seen[face].mean() for one in runs.values()]
    return [*lines, "", f"At `{quality}`; {texels}, and of one {100 * float(np.mean(shown)):.0f} % of the face."]


def chosen(given: str, known: Sequence[str], least: int, what: str) -> list[str]:
    """Names out of a list with commas between.

    Raises:
        BadParameter: one is not known, or there are too few.
    """
    names = list(dict.fromkeys(given.split(",")))
    if len(names) < least or not set(names) <= set(known):
        raise typer.BadParameter(f"{what} is {given!r}; name {least} or more of {', '.join(known)}")
    return names


def main(
    data: Annotated[Path | None, typer.Option(help="Folder of reference heads; else $AVATARME_BENCH_DATA.")] = None,
    out: Annotated[Path, typer.Option(help="Folder that keeps the photos.")] = Path("build/bench"),
    kinds: Annotated[str, typer.Option(help="Of heads; one or more, with commas between.")] = ",".join(KINDS),
    lights: Annotated[str, typer.Option(help="Two or more, with commas between.")] = ",".join(LIGHTS),
    photos: Annotated[int, typer.Option(min=1, max=len(YAWS), help="Of each avatar, each in another light.")] = 1,
    quality: Annotated[str, typer.Option(help="Level.")] = "draft",
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the tables into.")] = None,
) -> None:
    """Print the tables."""
    names = chosen(lights, LIGHTS, 2, "lights")
    wanted = chosen(kinds, list(KINDS), 1, "kinds")
    out.mkdir(parents=True, exist_ok=True)
    folder = data_folder(None if data is None else str(data))
    people = [(head, kind) for kind in wanted for head in KINDS[kind](folder, out)]
    kind_of = {head.name: kind for head, kind in people}
    runs: dict[tuple[str, str], Run] = {}
    for (first, light), (head, _) in itertools.product(enumerate(names), people):
        runs[head.name, light] = run(head, [*names[first:], *names[:first]][:photos], out, quality)
        typer.echo(f"{head.name} {light}: {runs[head.name, light].albedo[0]:.1f} dB", err=True)
    tell("\n".join(table(runs, kind_of, quality)), MARK, write)


if __name__ == "__main__":
    typer.run(main)
