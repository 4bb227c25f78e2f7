"""What hair cards leave open, beside the strands that they are made from: ``python -m benchmarks.hair_cards``.

For each style, from five sides: the largest connected gap in mm^2 (the body of hair that the strands fill, but through
which skin or background is seen; a parting is one), all gaps on the crown seen from above, strands per millimetre
across ribbons, the difference of colour to the strands under white light (CIE 1976), triangles, bytes of the textures,
and seconds.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import numpy.typing as npt
import typer

from models.hair.draw import draw, facing
from service.archive.images import encode_png
from service.arrays import Float32
from service.colour import bytes_to_linear, linear_to_lab
from service.geometry.camera import Camera
from service.hair.cards import BUDGETS, CUTOFF, HAIR, hair_parts
from service.hair.groom import Groom, make_groom
from service.hair.scalp import CROWN, mean_scalp
from service.hair.style import NAMED, sample_style
from service.head.files import load_head
from service.levels import QualityName
from service.materials.material import OwnMap
from service.materials.part import MeshPart
from service.render.draw import DrawnHead, see

SIDES = (0.0, 40.0, 90.0, 180.0)
"""Azimuths, degrees; and from above."""
SIZE = 900
"""Pixels of a picture's side, each about half a millimetre."""
CLOSED_MM = 3.0
"""Gaps between strands that are narrower belong to the body of hair."""
CROWN_MM = 45.0
"""Radius of the crown."""
BORDER_MM = 6.0
"""Width of the outline of the body of hair that is not looked at: there strands thin out."""


def above(size: int) -> Camera:
    """A camera over the head, whose picture has the face below."""
    front = facing(0.0, size)
    place, rotation = np.array([0.0, 1.4, -0.08]), np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    return Camera(size, size, front.focal_px, front.principal_point, rotation, -rotation @ place)


def covered(parts: tuple[MeshPart, ...], camera: Camera) -> Float32:
    """(H, W) opacity in [0, 1] of the hair in a picture."""
    head = load_head()
    seen = see(DrawnHead.of(head, head.mean, parts), camera, 1)
    left = np.zeros(camera.width * camera.height)
    for one in seen.parts:
        if one.along is not None:
            np.add.at(left, one.pixel, np.log(np.maximum(1 - one.alpha, 1e-4)))
    return np.asarray(1 - np.exp(left), np.float32).reshape(camera.height, camera.width)


def gaps(groom: Groom, parts: tuple[MeshPart, ...], camera: Camera) -> npt.NDArray[np.uint8]:
    """(H, W) 1 where strands fill the picture and cards do not."""
    pixel = 1000 * 1.4 / camera.focal_px
    hair = (draw(groom, load_head(), camera).hair > 0.2).astype(np.uint8)
    closing = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * round(CLOSED_MM / pixel) + 1,) * 2)
    inner = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * round(BORDER_MM / pixel) + 1,) * 2)
    body = cv2.erode(cv2.morphologyEx(hair, cv2.MORPH_CLOSE, closing), inner)
    return np.asarray((body > 0) & (covered(parts, camera) < 0.5), np.uint8)


def largest_mm2(mask: npt.NDArray[np.uint8], pixel: float) -> float:
    """Area of the largest connected piece of a mask."""
    areas = cv2.connectedComponentsWithStats(mask, connectivity=8)[2][1:, cv2.CC_STAT_AREA]
    return float(areas.max(initial=0)) * pixel * pixel


def strands_per_mm(part: MeshPart) -> float:
    """Median over ribbons of the strands that their middle shows, over their width."""
    picture = part.material.colour_map
    if not isinstance(picture, OwnMap):
        raise TypeError(f"{part.name} has no texture of its own")
    side = len(picture.pixels)
    shown = picture.pixels[..., 3] > 255 * CUTOFF
    width = np.linalg.norm(part.vertices[1::2] - part.vertices[::2], axis=1) * 1000
    left, right, row = part.uv[::2, 0] * side, part.uv[1::2, 0] * side, (1 - part.uv[::2, 1]) * side
    found = []
    for index in np.linspace(0, len(width) - 1, 400).astype(int):
        line = shown[min(int(row[index]), side - 1), int(left[index]) : int(right[index])].astype(int)
        if line.any():  # not at a root or a tip
            found.append((np.diff(line) == 1).sum() / max(width[index], 0.1))
    return float(np.median(found))


def colour_error(groom: Groom, part: MeshPart) -> float:
    """CIE 1976 difference of the mean of what the texture shows to that of the strands."""
    picture = part.material.colour_map
    if not isinstance(picture, OwnMap):
        raise TypeError(f"{part.name} has no texture of its own")
    shown = bytes_to_linear(picture.pixels[..., :3])[picture.pixels[..., 3] > 200].mean(0)
    own = groom.colour.linear().reshape(-1, 3).mean(0)
    both = linear_to_lab(np.stack([shown, own]).astype(np.float32))
    return float(np.linalg.norm(both[0] - both[1]))


def main(
    quality: Annotated[str, typer.Option(help="Level.")] = "standard",
    seeds: Annotated[int, typer.Option(help="Random styles beside the named ones.")] = 6,
    strands: Annotated[int, typer.Option(min=1, help="Of a full head.")] = 10_000,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Folder for pictures of the gaps.")] = None,
) -> None:
    """Measure and print a table."""
    level: QualityName = quality  # type: ignore[assignment]
    styles = [*NAMED.values(), *(sample_style(seed) for seed in range(seeds))]
    typer.echo("| style | curl | largest gap mm2 | crown mm2 | strands/mm | colour | triangles | MB | s |")
    typer.echo("|---|---|---|---|---|---|---|---|---|")
    for number, style in enumerate(styles):
        groom = make_groom(style, 3, strands)
        begin = time.process_time()
        parts = hair_parts(groom, mean_scalp(), BUDGETS[level])
        took = time.process_time() - begin
        cameras = {**{f"{side:.0f}": facing(side, SIZE) for side in SIDES}, "above": above(SIZE)}
        open_ = {name: gaps(groom, parts, camera) for name, camera in cameras.items()}
        pixel = 1000 * 1.4 / next(iter(cameras.values())).focal_px
        largest = max(largest_mm2(mask, pixel) for mask in open_.values())
        top = cameras["above"].project(CROWN[None])[0]
        blank, place = np.zeros((SIZE, SIZE), np.uint8), (round(top[0]), round(top[1]))
        near = np.asarray(cv2.circle(blank, place, round(CROWN_MM / pixel), 1, -1), np.uint8)
        crown = float((open_["above"] & near).sum()) * pixel * pixel
        cards = next(part for part in parts if part.name == HAIR)
        size = sum(len(encode_png(one.pixels, srgb=False, level=7)) for one in cards.own_maps)
        faces = sum(len(part.faces) for part in parts)
        typer.echo(
            f"| {style.kind} | {style.curl} | {largest:.1f} | {crown:.1f} | {strands_per_mm(cards):.1f} | "
            f"{colour_error(groom, cards):.1f} | {faces} | {size / 1e6:.1f} | {took:.1f} |"
        )
        if output is not None:
            output.mkdir(parents=True, exist_ok=True)
            strip = np.concatenate([255 * mask for mask in open_.values()], 1)
            cv2.imwrite(str(output / f"{number}_{style.kind}.png"), strip)


if __name__ == "__main__":
    typer.run(main)
