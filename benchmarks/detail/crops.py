"""Pieces of a photo at 1:1 beside the same skin of its maps: ``python -m benchmarks.detail.crops PHOTO... --out DIR``.

One picture for each photo, a row for each place: the photo, ``texture``, the diffuse albedo, the specular normals and
the displacement (grey 0, 0.2 mm from black to white), all as the photo's pixels see them. Where the fitted head does
not lie is grey.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import numpy.typing as npt
import typer

from benchmarks.metrics import View, at_chart
from service.archive.avatar import Avatar
from service.geometry.normals import vertex_normals
from service.head.regions import vertex_mask
from service.options import Options
from service.pipeline import make_avatar
from service.reflectance.reflectance_maps import MID, SCALE_MM, unpack_normals

PLACES = ("cheek_left", "cheek_right", "brow", "lips", "ear_left", "ear_right")
SIDE = 200
"""Pixels of a piece, and of the photo that it shows."""
DEPTH_MM = 0.2
MAPS = ("diffuse_albedo", "specular_normal", "displacement", "texture")
GREY = 128

Picture = npt.NDArray[np.uint8]


def middle(avatar: Avatar, place: str) -> tuple[int, int] | None:
    """Pixel of the photo in the middle of a place; None where it looks away from the camera."""
    head, fit = avatar.head, avatar.fit
    weight = vertex_mask(head, "brow_left" if place == "brow" else place)
    normal = vertex_normals(fit.vertices, head.triangles) @ fit.camera.rotation.T
    chosen = (weight > 0.5) & (normal[:, 2] < -0.3)
    if not chosen.any():
        return None
    x, y = np.median(fit.camera.project(fit.vertices[chosen]), 0)
    return int(x), int(y)


def maps_of(avatar: Avatar) -> list[npt.NDArray[np.float32]]:
    """Maps (h, w, 3) as colours in [0, 255]."""
    made = avatar.reflectance
    assert made is not None and made.diffuse_albedo is not None  # noqa: S101 - asked for
    assert made.specular_normal is not None and made.displacement is not None  # noqa: S101
    texture = avatar.texture.texture if avatar.own_texture is None else avatar.own_texture
    height = (made.displacement.astype(np.float32) - MID) * np.float32(SCALE_MM * 255 / DEPTH_MM) + GREY
    return [
        texture.astype(np.float32),
        made.diffuse_albedo.astype(np.float32) / np.float32(257),
        np.asarray(127.5 * (unpack_normals(made.specular_normal) + 1), np.float32),
        np.repeat(height[..., None], 3, 2),
    ]


def sheet(avatar: Avatar) -> Picture:
    """(rows * SIDE, 5 * SIDE, 3) RGB: a row for each place that the photo shows."""
    pixels = avatar.photo.pixels
    view, maps = View.of(avatar.fit, avatar.head, pixels.shape[:2]), maps_of(avatar)
    border = ((SIDE, SIDE), (SIDE, SIDE))
    wide, seen = np.pad(pixels, (*border, (0, 0))), np.pad(view.skin, border)
    places = np.pad(view.uv, (*border, (0, 0)))
    rows = []
    for place in PLACES:
        found = middle(avatar, place)
        if found is None or not (0 <= found[0] < pixels.shape[1] and 0 <= found[1] < pixels.shape[0]):
            continue
        here = tuple(slice(at + SIDE // 2, at + SIDE // 2 + SIDE) for at in found[::-1])
        pieces = [wide[here]]
        for one in maps:
            piece = np.clip(np.rint(at_chart(one, places[here])), 0, 255)
            pieces.append(np.where(seen[here][..., None], piece, GREY).astype(np.uint8))
        rows.append(np.hstack(pieces))
    return np.vstack(rows) if rows else np.zeros((0, 5 * SIDE, 3), np.uint8)


def main(
    photos: Annotated[list[Path], typer.Argument(help="Photos.")],
    out: Annotated[Path, typer.Option(help="Folder for the pictures.")] = Path("build/crops"),
    quality: Annotated[str, typer.Option(help="draft, standard, high or reference.")] = "standard",
) -> None:
    """Write a PNG for each photo, and print its path with what the photo tells of each octave."""
    out.mkdir(parents=True, exist_ok=True)
    for photo in photos:
        options = Options(quality=quality, maps=MAPS, face="largest")  # type: ignore[arg-type]
        avatar = make_avatar(photo.read_bytes(), options)
        target = out / f"{photo.stem}.png"
        cv2.imwrite(str(target), sheet(avatar)[..., ::-1])
        told = avatar.reflectance.detail if avatar.reflectance is not None else None
        octaves = () if told is None else told.octaves
        shares = [f"{one.shortest_mm:g}-{one.longest_mm:g} mm {one.share:.0%}" for one in octaves]
        typer.echo(f"{target}: {', '.join(shares) or 'texture only'}")


if __name__ == "__main__":
    typer.run(main)
