"""The same heads in several lights: ``python -m benchmarks.light_spread --data DIR [--write docs/reflectance.md]``.

DIR holds ``ict_facekit_head.npz`` and ``ffhq_uv_head/``, which no training has seen. Mitsuba takes a photo of each head
in each light; the program makes a diffuse albedo of each photo. Two questions:

- How far is it from the true albedo? PSNR of sRGB-coded skin over the pixels of the photo where both heads show the
  face, and the same after the one gain of linear values that fits best: how dark a skin is, and how bright its light,
  is all but impossible to tell from a photo.
- How much of the light is left in it? Root mean square over texels of the standard deviation over lights, beside that
  over heads of the mean over lights. All heads share one chart; texels count that every photo shows.

Beside both stands the texture itself, with the photo's light in it. Photos are kept in ``--out`` and not taken again.
Broken off (Ctrl-C), it prints the tables of the lights in which all heads are done.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import typer

from benchmarks.heads import IctHeads, Skin, TexturedHead, subdivided, varied
from benchmarks.metrics import FACE_RADIUS, FACING
from benchmarks.render import LAMPS, Shot, take
from benchmarks.shoot import FFHQ_EYES_M, data_folder, ffhq_head, ict_colours, landmarks_on
from models.tables import write_between
from service.archive.avatar import Avatar
from service.colour import linear_to_srgb, srgb_to_linear
from service.geometry.raster import rasterise

Float = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

MARK = ("<!-- light-spread -->", "<!-- /light-spread -->")
LIGHTS = ("soft", *LAMPS)
ICT_SEEDS = (100, 103, 106, 109)
SIZE = 512
COMPARED_WIDTH = 384
"""Maps are averaged to this width before lights are compared: fits differ by a texel or two of the finer map."""

NEAR_M = 0.004
"""A pixel shows skin where the nearest vertex of the head's own mesh is not further."""

SEEN = 160
"""Confidence from which on a texel counts as seen."""


@dataclass(frozen=True)
class Run:
    """One photo: PSNR in dB of albedo and texture, raw and after the best gain; both maps, small, sRGB in [0, 1]."""

    albedo: tuple[float, float]
    texture: tuple[float, float]
    maps: Mapping[str, Float]
    seen: Mask


def heads(data: Path, out: Path, count: int) -> list[TexturedHead]:
    """The head of FFHQ-UV, then heads of ICT-FaceKit with skins of other tones."""
    skin = Skin.load(data / "ffhq_uv_head")
    reference = ffhq_head(skin)
    found = [reference]
    if count > 1:
        ict = IctHeads(data / "ict_facekit_head.npz")
        cached = (out / "skin.npy").is_file()
        landmarks = np.zeros((0, 3)) if cached else landmarks_on(reference, out, "reference_skin")
        colours = ict_colours(ict, skin, landmarks, FFHQ_EYES_M.mean(0), out)
        for seed in ICT_SEEDS[: count - 1]:
            vertices, eyes = ict.sample(seed)
            fine, triangles = subdivided(vertices, ict.triangles, 2)
            found.append(TexturedHead(f"ict{seed}", fine, triangles, varied(colours, seed), eyes, 0.0121))
    return found


def photo_of(head: TexturedHead, light: str, out: Path) -> Path:
    """Path, without ending, of the photo of a head in a light; taken where it is not there."""
    path = out / f"spread_{head.name}_{light}"
    if not Path(f"{path}.npz").is_file():
        take(head, Shot(8.0, light, 1.2, 18.0, SIZE), path)
    return path


def true_albedo(head: TexturedHead, position: Float, mask: Mask) -> tuple[Float, Mask]:
    """(H, W, 3) linear albedo of each pixel, the mean of the three nearest vertices'; and which pixels show skin."""
    from scipy.spatial import cKDTree

    distance, index = cKDTree(head.vertices).query(position[mask], k=3)
    weight = 1 / np.maximum(distance, 1e-6)
    albedo, near = np.zeros((*mask.shape, 3)), np.zeros(mask.shape, bool)
    albedo[mask] = (head.colours[index] * weight[..., None]).sum(1) / weight.sum(1, keepdims=True)
    eyes = np.linalg.norm(position[mask][:, None] - head.eyes, axis=2).min(1) < 1.05 * head.eye_radius
    near[mask] = (distance[:, 0] < NEAR_M) & ~eyes
    return albedo, near


def shown(avatar: Avatar, maps: Sequence[Float], shape: tuple[int, int]) -> tuple[list[Float], Mask]:
    """Maps (h, w, 3) on the chart, as the camera of the fit sees them (H, W, 3); and where it sees skin."""
    import cv2

    head, fit = avatar.head, avatar.fit
    height, width = shape
    depth = fit.camera.to_camera(fit.vertices)[:, 2]
    raster = rasterise(fit.camera.project(fit.vertices), depth, head.triangles, width, height, perspective=True)
    hit = raster.mask
    uv = np.zeros((height, width, 2))
    corners = head.uv[head.triangle_uv[raster.triangle[hit]]]
    uv[hit] = (corners * raster.barycentric[hit][..., None]).sum(1)
    skin = hit.copy()
    skin[hit] = head.triangle_part[raster.triangle[hit]] == head.part_names.index("skin")
    seen = []
    for plane in maps:
        x = (uv[..., 0] * plane.shape[1] - 0.5).astype(np.float32)
        y = ((1 - uv[..., 1]) * plane.shape[0] - 0.5).astype(np.float32)
        seen.append(np.asarray(cv2.remap(plane.astype(np.float32), x, y, cv2.INTER_LINEAR), np.float64))
    return seen, skin


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


def run(head: TexturedHead, light: str, out: Path, quality: str) -> Run:
    """Take the photo, make the albedo, compare.

    Raises:
        AvatarError: as ``service.pipeline.make_avatar``.
    """
    import cv2

    from service.options import Options
    from service.pipeline import make_avatar

    path = photo_of(head, light, out)
    options = Options(maps=("diffuse_albedo", "texture", "confidence"), quality=quality, face="largest")  # type: ignore[arg-type]
    avatar = make_avatar(Path(f"{path}.png").read_bytes(), options)
    assert avatar.reflectance is not None and avatar.reflectance.diffuse_albedo is not None  # noqa: S101 - asked for
    maps = {"albedo": avatar.reflectance.diffuse_albedo / 65535.0, "texture": avatar.texture.texture / 255.0}
    with np.load(f"{path}.npz") as truth:
        position, normal = truth["position"].astype(np.float64), truth["normal"].astype(np.float64)
        albedo, skin = true_albedo(head, position, truth["mask"])
        turn = np.radians(float(truth["yaw"]))
    (ours, texture), fitted = shown(avatar, [maps["albedo"], maps["texture"]], skin.shape)
    iod = float(np.linalg.norm(head.eyes[0] - head.eyes[1]))
    centre = head.eyes.mean(0) - [0, 0.55 * iod, 0]
    facing = normal @ np.array([np.sin(turn), 0.05, np.cos(turn)]) > FACING
    face = skin & fitted & facing & (np.linalg.norm(position - centre, axis=-1) < FACE_RADIUS * iod)
    coded = linear_to_srgb(albedo[face].astype(np.float32)).astype(np.float64)
    size = (COMPARED_WIDTH, COMPARED_WIDTH * 2 // 3)
    small = {k: np.asarray(cv2.resize(v, size, interpolation=cv2.INTER_AREA), np.float64) for k, v in maps.items()}
    seen = cv2.resize(avatar.texture.confidence, size, interpolation=cv2.INTER_AREA) >= SEEN
    return Run(psnr(ours[face], coded), psnr(texture[face], coded), small, seen)


def spread(runs: Mapping[tuple[str, str], Run], name: str) -> tuple[float, float]:
    """Standard deviation over lights and over heads of a map: root mean square over texels that all photos show."""
    common = np.logical_and.reduce([one.seen for one in runs.values()])
    people = list(dict.fromkeys(who for who, _ in runs))
    values = {who: np.stack([one.maps[name][common] for key, one in runs.items() if key[0] == who]) for who in people}
    over_lights = float(np.sqrt(np.mean([part.var(0, ddof=1) for part in values.values()])))
    means = np.stack([part.mean(0) for part in values.values()])
    return over_lights, float(np.sqrt(means.var(0, ddof=1).mean()))


def table(runs: Mapping[tuple[str, str], Run], quality: str) -> list[str]:
    """Markdown."""
    lines = [
        "| head | light | albedo dB | best gain | texture itself dB | best gain |",
        "|---" * 6 + "|",
    ]
    for (who, light), one in runs.items():
        lines.append(
            f"| {who} | {light} | " + " | ".join(f"{value:.1f}" for value in (*one.albedo, *one.texture)) + " |"
        )
    columns = np.array([(*one.albedo, *one.texture) for one in runs.values()])
    lines.append("| median | | " + " | ".join(f"**{value:.1f}**" for value in np.median(columns, 0)) + " |")
    lines += ["", "| standard deviation (sRGB, 255 = 1) | over lights | over heads | ratio |", "|---" * 4 + "|"]
    for name in ("albedo", "texture"):
        lights, people = (255 * value for value in spread(runs, name))
        lines.append(f"| {name} | {lights:.1f} | {people:.1f} | {lights / max(people, 1e-9):.2f} |")
    count = int(np.logical_and.reduce([one.seen for one in runs.values()]).sum())
    return [
        *lines,
        "",
        f"At `{quality}`; {count} texels of {COMPARED_WIDTH} x {COMPARED_WIDTH * 2 // 3} are seen in all photos.",
    ]


def main(
    data: Annotated[Path | None, typer.Option(help="Folder of reference heads; else $AVATARME_BENCH_DATA.")] = None,
    out: Annotated[Path, typer.Option(help="Folder that keeps the photos.")] = Path("build/bench"),
    subjects: Annotated[int, typer.Option(min=2, max=1 + len(ICT_SEEDS), help="How many heads.")] = 3,
    lights: Annotated[str, typer.Option(help="Two or more, with commas between.")] = ",".join(LIGHTS),
    quality: Annotated[str, typer.Option(help="Level.")] = "draft",
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the tables into.")] = None,
) -> None:
    """Print the tables."""
    names = lights.split(",")
    unknown = [name for name in names if name not in LIGHTS]
    if unknown or len(names) < 2:
        raise typer.BadParameter(f"lights is {lights!r}; name two or more of {', '.join(LIGHTS)}")
    out.mkdir(parents=True, exist_ok=True)
    folder = data_folder(None if data is None else str(data))
    runs: dict[tuple[str, str], Run] = {}
    people = heads(folder, out, subjects)
    with contextlib.suppress(KeyboardInterrupt):  # what is done by then is worth a table
        # Lights outside: whoever breaks it off has all heads in the lights that are done.
        for light, head in itertools.product(names, people):
            runs[head.name, light] = run(head, light, out, quality)
            typer.echo(f"{head.name} {light}: {runs[head.name, light].albedo[0]:.1f} dB", err=True)
    done = [light for light in names if all((head.name, light) in runs for head in people)]
    if len(done) < 2:
        raise SystemExit("broken off before two lights were done: there is no spread over one")
    lines = "\n".join(table({key: one for key, one in runs.items() if key[1] in done}, quality))
    typer.echo(lines)
    if write is not None:
        write_between(write, MARK, lines)


if __name__ == "__main__":
    typer.run(main)
