"""Pictures and films of the avatar in an archive.

On a turntable the camera goes round the head once, as the light stays with the head.
"""

from __future__ import annotations

import dataclasses
import io
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO

import numpy as np

from service.archive.container import replace_file
from service.archive.reading import AvatarFile, open_avatar
from service.archive.surfaces import subdivided_head
from service.arrays import AnyFloat, UInt8
from service.errors import OutputFault, UsageError
from service.geometry.remesh import Subdivision
from service.head.model import HeadModel
from service.materials.part import MeshPart, framed, material_of
from service.render.drawn import without_parts
from service.render.render import Kept, RenderedPicture, render_head
from service.render.request import RenderRequest
from service.render.shade import Clock
from service.render.surface import ROLES
from service.render.view import turned_camera, viewpoint_of

MOST_POLYGONS = 20_000
"""Largest mesh that is subdivided before rendering; an archive's has about 4,500 polygons."""

LEAST, MOST = 2, 360
"""Pictures of a turn."""
SECONDS = 4.0
"""Length of a turn."""
ENDINGS = (".gif", ".mp4")


def render_archive(source: Path | IO[bytes], request: RenderRequest) -> RenderedPicture:
    """A picture of the avatar in an archive, a path or seekable stream.

    UsageError: no such file, or a request that is not possible. BadArchive, BadMesh: the archive cannot be used, or
    lacks a map that has no substitute. NumericFault: light that is not finite.
    """
    clock = Clock()
    with clock.step("open"):
        avatar = open_avatar(source, ROLES)
    with clock.step("mesh"):
        head, vertices, parts = stored_meshes(avatar)
    return render_head(head, vertices, avatar.maps, request, clock=clock, parts=parts)


def stored_meshes(avatar: AvatarFile) -> tuple[HeadModel, AnyFloat, tuple[MeshPart, ...]]:
    """The smoothed head of an archive without what others replace, its vertices, and the meshes beside its own."""
    facts = avatar.manifest.get("head")
    named = facts if isinstance(facts, dict) else {}
    whole = avatar.mesh.as_head(str(named.get("name", "head")), str(named.get("licence", "unknown")))
    head, vertices = smoothed(without_parts(whole, avatar.replaced), avatar.mesh.vertices)
    return head, vertices, avatar.parts


def smoothed(head: HeadModel, vertices: AnyFloat) -> tuple[HeadModel, AnyFloat]:
    """The head after one step of Catmull-Clark subdivision, so that silhouettes of the skin have no corners.

    Other parts are subdivided without smoothing, which would shrink coarse ones like teeth, and so is the skin at its
    open border, where the bust goes on along the same edges. Meshes of more than ``MOST_POLYGONS`` are returned
    unchanged.
    """
    if len(head.polygons) > MOST_POLYGONS:
        return head, vertices
    fine, smooth = subdivided_head(head, vertices, 1)
    skin = [i for i, name in enumerate(head.part_names) if material_of(name).detailed]
    there = np.zeros(len(smooth), bool)
    there[fine.triangles[np.isin(fine.triangle_part, skin)]] = True
    step = Subdivision.of(head.polygons, len(vertices))
    return fine, np.where((there & ~step.open_points())[:, None], smooth, step.linear(vertices))


def turntable(
    archive: Path,
    target: Path,
    request: RenderRequest,
    count: int,
    progress: Callable[[str, float], None] = lambda stage, done: None,
) -> int:
    """Render pictures around an avatar as GIF or MP4, by the ending of ``target``; gives the bytes of the film.

    ``count`` of them, ``LEAST`` to ``MOST``, are one turn, which begins at the azimuth of the request's view; exposure
    is that of the first picture, and the scale is the same in all of them. ``progress`` is told which picture is
    rendered, and the share that is done.

    UsageError: ``count``, the ending, a transparent background or an odd size of an MP4. BadArchive, BadMesh: the
    archive cannot be used. OutputFault: the film could not be written.
    """
    _check(target, request, count)
    avatar = open_avatar(archive, ROLES)
    head, vertices, parts = stored_meshes(avatar)
    around, kept = framed(vertices, parts), Kept()
    start = float(np.degrees(np.arctan2(*np.array(viewpoint_of(request.view, request.scene.viewpoints))[[0, 2]])))
    pictures: list[UInt8] = []
    for index in range(count):
        progress(f"picture {index + 1} of {count}", index / (count + 1))
        camera = turned_camera(around, -start - 360 * index / count, *request.size)
        made = render_head(head, vertices, avatar.maps, request, camera=camera, kept=kept, parts=parts)
        request = dataclasses.replace(request, scene=dataclasses.replace(request.scene, response=made.scene.response))
        pictures.append(made.pixels)
    progress("film", count / (count + 1))
    data = gif(pictures) if target.suffix.lower() == ".gif" else mp4(pictures)
    replace_file(target, lambda stream: stream.write(data))
    return len(data)


def gif(pictures: Sequence[UInt8]) -> bytes:
    """An endless GIF of pictures (h, w, 3) uint8 sRGB, with one palette, as several would flicker."""
    from PIL import Image

    strip = Image.fromarray(np.concatenate([picture[::4, ::4] for picture in pictures]))
    palette = strip.quantize(256, method=Image.Quantize.MEDIANCUT)
    way = Image.Dither.FLOYDSTEINBERG
    shown = [Image.fromarray(picture).quantize(palette=palette, dither=way) for picture in pictures]
    stream = io.BytesIO()
    shown[0].save(
        stream, "GIF", save_all=True, append_images=shown[1:], loop=0, optimize=False,
        duration=max(round(1000 * SECONDS / len(pictures)), 20),
    )  # fmt: skip
    return stream.getvalue()


def mp4(pictures: Sequence[UInt8]) -> bytes:
    """An MP4 (MPEG-4 part 2, which OpenCV's wheels can write) of pictures (h, w, 3) uint8 sRGB.

    OutputFault: OpenCV has no writer for it.
    """
    import cv2

    height, width = pictures[0].shape[:2]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        code = cv2.VideoWriter.fourcc(*"mp4v")
        film = cv2.VideoWriter(str(path), code, max(len(pictures) / SECONDS, 1.0), (width, height))
        if not film.isOpened():
            raise OutputFault("this OpenCV cannot write MP4; name a .gif")
        for picture in pictures:
            film.write(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
        film.release()
        return path.read_bytes()


def _check(target: Path, request: RenderRequest, count: int) -> None:
    if not LEAST <= count <= MOST:
        raise UsageError(f"turntable is {count}; {LEAST} to {MOST} pictures are right", field="turntable")
    if target.suffix.lower() not in ENDINGS:
        raise UsageError(f"a film is written to a {' or '.join(ENDINGS)}, not to {target}", field="output")
    if request.background == "transparent":
        raise UsageError("a film has no transparent background; black and environment are right", field="background")
    if target.suffix.lower() == ".mp4" and any(side % 2 for side in request.size):
        raise UsageError(f"sides of an MP4 are even; size is {request.size[0]}x{request.size[1]}", field="size")
