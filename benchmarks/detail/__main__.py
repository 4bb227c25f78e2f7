"""What a sharp photo shows of the skin, and what of it is in the maps: ``python -m benchmarks.detail --data DIR``.

DIR holds ``lee_perry_smith/``, ``hifi3d_uv/``, ``ict_facekit_head.npz`` and ``ffhq_uv_head/``, which no training has
seen. Mitsuba takes sharp photos of heads whose colour and relief are known (``benchmarks.detail.shoot``); a camera
adds blur, noise and JPEG; ``make_avatar`` makes the maps. On the skin that a photo shows, bands of 0.6-1.2, 1.2-2.5 and
2.5-6 mm of the logarithm of coded luma are compared with the true albedo's, in the photo's frame: correlation /
strength. Beside ours stand the photo itself, made small to the texture of 576 x 384 as well, the specular normals with
the true ones, and the displacement with the heights that the true normals have, also its depth along the deepest
creases.

Photos are kept in ``--out``. A row takes as long as an avatar at ``standard``.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import numpy.typing as npt
import typer

from benchmarks.detail.measure import BANDS_MM, Agreement, compare
from benchmarks.detail.shoot import NAMES, Taken, shot, sitter, taken
from models.tables import tell
from service.colour import linear_to_srgb
from service.options import Options
from service.pipeline import make_avatar

MARK = ("<!-- detail -->", "<!-- /detail -->")
SIZE = 1300
"""Pixels of the square photos: 6.8 a millimetre."""
YAW = 6.0
CLEAN = 1 / 255
"""Noise of a good camera in good light, standard deviation of sRGB-coded values."""

Pixels = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Camera:
    """What happens between lens and file: blur in pixels, noise of coded values, JPEG quality (None: PNG)."""

    name: str
    blur: float = 0.0
    noise: float = CLEAN
    quality: int | None = None

    def file(self, photo: Taken) -> tuple[bytes, Pixels]:
        """The file, and the pixels that are in it."""
        seen = cv2.GaussianBlur(photo.radiance, (0, 0), self.blur) if self.blur else photo.radiance
        coded = linear_to_srgb(np.clip(seen, 0, 1))
        noisy = coded + np.random.default_rng(0).normal(0, self.noise, coded.shape)
        pixels = np.rint(255 * np.clip(noisy, 0, 1)).astype(np.uint8)
        how = (".png", []) if self.quality is None else (".jpg", [cv2.IMWRITE_JPEG_QUALITY, self.quality])
        data = cv2.imencode(how[0], pixels[..., ::-1], how[1])[1].tobytes()
        return data, np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR), np.uint8)[..., ::-1]


CAMERAS = (
    Camera("clean"), Camera("blur 1", blur=1.0), Camera("blur 2", blur=2.0), Camera("blur 4", blur=4.0),
    Camera("noise 8", noise=8 / 255), Camera("noise 20", noise=20 / 255),
    Camera("JPEG 95", quality=95), Camera("JPEG 75", quality=75), Camera("JPEG 50", quality=50),
)  # fmt: skip


def cells(found: tuple[Agreement, ...]) -> str:
    """Of a table: correlation / strength by band."""
    return " | ".join(f"{one.correlation:.2f} / {one.strength:.2f}" for one in found) if found else " | ".join("---")


def rows(
    data: Path, out: Path, who: list[str], lights: list[str], cameras: list[Camera], relief: bool
) -> Iterator[str]:
    """Rows of the first table."""
    maps = ("diffuse_albedo", *(("specular_normal", "displacement") if relief else ()))
    for name in who:
        head = sitter(name, data, out)
        for light in lights:
            photo = taken(head, shot(light, YAW, SIZE), out)
            for camera in cameras:
                file, pixels = camera.file(photo)
                made = make_avatar(file, Options(maps=maps, face="largest"))
                found = compare(made, pixels, photo, head.unfit)
                told = made.reflectance.detail if made.reflectance is not None else None
                share = "-" if told is None else " ".join(f"{100 * one.share:.0f}" for one in told.octaves)
                kinds = (found.photo, found.texture, found.albedo, found.normals, found.relief)
                deep = (
                    "-"
                    if found.creases_mm is None
                    else "{1:.3f} of {0:.3f}, {2:.3f} anywhere".format(*found.creases_mm)
                )
                parts = " | ".join(cells(one) for one in kinds)
                yield f"| {name} | {light} | {camera.name} | {parts} | {deep} | {share} |"


def main(
    data: Annotated[Path | None, typer.Option(help="Folder of reference heads; else $AVATARME_BENCH_DATA.")] = None,
    out: Annotated[Path, typer.Option(help="Folder that keeps the photos.")] = Path("build/bench"),
    who: Annotated[str, typer.Option(help="Heads, with commas between.")] = "scan,hifi3d 1",
    lights: Annotated[str, typer.Option(help="Of benchmarks.render, with commas between; '' for none.")] = "soft,left",
    cameras: Annotated[str, typer.Option(help="Cameras, with commas between, or 'all'.")] = "clean",
    relief: Annotated[bool, typer.Option(help="Compare normals and displacement, too.")] = True,
    write: Annotated[Path | None, typer.Option(help="Markdown file to put the tables into.")] = None,
) -> None:
    """Print the tables."""
    folder = data or Path(os.environ.get("AVATARME_BENCH_DATA", ""))
    heads, names = who.split(","), [one.name for one in CAMERAS] if cameras == "all" else cameras.split(",")
    if not set(heads) <= set(NAMES) or not set(names) <= {one.name for one in CAMERAS}:
        known = ", ".join((*NAMES, *(one.name for one in CAMERAS)))
        raise typer.BadParameter(f"{who!r} and {cameras!r}: there are {known}")
    out.mkdir(parents=True, exist_ok=True)
    bands = [f"{low:g}-{high:g}" for low, high in BANDS_MM]
    kinds = ("photo itself", "texture 576", "albedo", "normals", "displacement")
    lines = ["| head | light | camera | " + " | ".join(f"{kind} {one}" for kind in kinds for one in bands)
             + " | creases, mm | photo's share by octave, % |"]  # fmt: skip
    lines.append("|---" * (5 + len(kinds) * len(bands)) + "|")
    chosen = [one for one in CAMERAS if one.name in names]
    for row in rows(folder, out, heads, lights.split(",") if lights else [], chosen, relief):
        typer.echo(row, err=True)
        lines.append(row)
    tell("\n".join(lines), MARK, write)


if __name__ == "__main__":
    typer.run(main)
