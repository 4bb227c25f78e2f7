"""Colour of hair from there and back: ``python -m benchmarks.hair_colour PHOTO... [--write docs/hair.md]``.

A head wears hair of a known colour, our renderer takes its picture in three lights, and the program makes an avatar of
that picture: how far is its hair's colour under white light from the one it was drawn with? CIE Delta E (1976) of the
means over strands; 6 is wanted. Highlights are in the picture as in a photo.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from models.tables import tell
from service.archive.pack import write_archive
from service.archive.rendering import render_archive
from service.arrays import Float32
from service.colour import linear_to_srgb
from service.hair.colour import HairColour
from service.light.scene import Environment, PointLight, Response, Scene, Softbox
from service.options import Options
from service.pipeline import make_avatar
from service.render.request import RenderRequest

MARK = ("<!-- hair-colour -->", "<!-- /hair-colour -->")
NAMES = ("black", "dark_brown", "light_brown", "blond", "red", "grey")
SIZE = (600, 800)
"""Width and height of the pictures."""


def scenes() -> dict[str, Scene]:
    """Lights of common photos: a clouded sky, a window at the side, a flash in a dim room."""
    response = Response(target=0.7, shoulder=0.3)
    dim = Environment(zenith=(0.1,) * 3, horizon=(0.1,) * 3, ground=(0.1,) * 3)
    beside = Softbox((0.8, 0.2, 0.6), (6.0,) * 3, 8.0)
    return {
        "sky": Scene(Environment(zenith=(1.0,) * 3, horizon=(0.6,) * 3, ground=(0.15,) * 3), response=response),
        "window": Scene(
            Environment(zenith=(0.15,) * 3, horizon=(0.15,) * 3, ground=(0.1,) * 3, softboxes=(beside,)),
            response=response,
        ),
        "flash": Scene(dim, lights=(PointLight((0.05, 0.15, 1.2), (3.0,) * 3, 0.05),), response=response),
    }


def lab(colour: Float32) -> Float32:
    """(3,) CIE L*a*b* of linear RGB (3,)."""
    coded = np.asarray(linear_to_srgb(np.clip(colour, 0, 1)), np.float32)
    return np.asarray(cv2.cvtColor(coded[None, None], cv2.COLOR_RGB2LAB)[0, 0], np.float32)


def worn(data: bytes, colour: str) -> tuple[io.BytesIO, Float32]:
    """The archive of a head that wears a colour, or the photo's with "auto", and its mean linear RGB (3,)."""
    avatar = make_avatar(data, Options(quality="draft", face="largest", hair_colour=colour))
    groom = None if avatar.hair is None else avatar.hair.groom
    if groom is None:
        raise ValueError("the head wears no hair")
    archive = io.BytesIO()
    write_archive(avatar, archive)
    archive.seek(0)
    return archive, mean_of(groom.colour)


def mean_of(colour: HairColour) -> Float32:
    """(3,) linear RGB."""
    return np.asarray(colour.linear().reshape(-1, 3).mean(0), np.float32)


def measured(photo: Path) -> Iterator[tuple[str, str, float, float]]:
    """Colour, light, Delta E, and the difference of L*, of each colour of ``NAMES`` in each light."""
    for name in NAMES:
        archive, truth = worn(photo.read_bytes(), name)
        for light, scene in scenes().items():
            archive.seek(0)
            asked = RenderRequest(scene=scene, size=SIZE, view="front", background="environment")
            drawn = render_archive(archive, asked)
            picture = cv2.imencode(".png", np.ascontiguousarray(drawn.pixels[..., ::-1]))[1].tobytes()
            found = worn(picture, "auto")[1]
            off = lab(found) - lab(truth)
            yield name, light, float(np.linalg.norm(off)), float(off[0])


def main(
    photos: Annotated[list[Path], typer.Argument(help="Photos whose heads wear the colours.")],
    write: Annotated[Path | None, typer.Option(help="Page to write the table into.")] = None,
) -> None:
    """Print a table of colours by lights."""
    rows = [row for photo in photos for row in measured(photo)]
    lights = list(scenes())
    lines = [f"| hair | {' | '.join(lights)} | all |", "|---" * (len(lights) + 2) + "|"]
    for name in (*NAMES, "all"):
        cells = []
        for light in (*lights, "all"):
            of = [row for row in rows if name in (row[0], "all") and light in (row[1], "all")]
            cells.append(f"{np.mean([row[2] for row in of]):.1f} ({np.mean([row[3] for row in of]):+.1f})")
        lines.append(f"| {name.replace('_', ' ')} | {' | '.join(cells)} |")
    tell("\n".join(lines), MARK, write)


if __name__ == "__main__":
    typer.run(main)
