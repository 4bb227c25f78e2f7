"""A film of a head on a turntable: the camera goes round it once, as the light stays with the head."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from service.archive.container import replace_file
from service.archive.reading import open_avatar
from service.arrays import AnyFloat, UInt8
from service.errors import OutputFault, UsageError
from service.geometry.camera import Camera
from service.materials.part import framed
from service.render.render import Kept, meshes, render_head
from service.render.request import RenderRequest
from service.render.surface import ROLES
from service.render.view import camera_at, viewpoint_of

LEAST, MOST = 2, 360
"""Pictures of a turn."""

SECONDS = 4.0
"""Length of a turn."""

ENDINGS = (".gif", ".mp4")


def turntable(
    archive: Path,
    target: Path,
    request: RenderRequest,
    count: int,
    progress: Callable[[str, float], None] = lambda stage, done: None,
) -> int:
    """Render ``count`` pictures around an avatar and write them as GIF or MP4, by the ending of ``target``.

    Exposure is that of the first picture, and the scale is the same in all of them.

    Args:
        archive: path of the archive.
        target: ends in ``.gif`` or ``.mp4``.
        request: scene, size and the like; the camera begins at its view.
        count: pictures of the turn, ``LEAST`` to ``MOST``.
        progress: told which picture is rendered, and the share that is done.

    Returns:
        Bytes of the film.

    Raises:
        UsageError: ``count``, the ending, a transparent background or an odd size of an MP4.
        BadArchive, BadMesh: the archive cannot be used.
        OutputFault: the film could not be written.
    """
    _check(target, request, count)
    avatar = open_avatar(archive, ROLES)
    head, vertices, parts = meshes(avatar)
    start = np.degrees(np.arctan2(*np.array(viewpoint_of(request.view, request.scene.viewpoints))[[0, 2]]))
    cameras = around(framed(vertices, parts), request, [float(start + 360 * index / count) for index in range(count)])
    pictures: list[UInt8] = []
    kept = Kept()
    for index, camera in enumerate(cameras):
        progress(f"picture {index + 1} of {count}", index / (count + 1))
        made = render_head(head, vertices, avatar.maps, request, camera=camera, kept=kept, parts=parts)
        request = dataclasses.replace(request, scene=dataclasses.replace(request.scene, response=made.scene.response))
        pictures.append(_decoded(made.png))
    progress("film", count / (count + 1))
    data = gif(pictures) if target.suffix.lower() == ".gif" else mp4(pictures)
    replace_file(target, lambda stream: stream.write(data))
    return len(data)


def around(vertices: AnyFloat, request: RenderRequest, degrees: Sequence[float]) -> list[Camera]:
    """Cameras at these angles about the head, with one focal length at which the head fills no picture over the rim."""
    width, height = request.size
    found = [camera_at(viewpoint_of(f"{(one + 180) % 360 - 180:.6f}", ()), vertices, width, height) for one in degrees]
    focal = min(camera.focal_px for camera in found)
    return [_rescaled(camera, vertices, focal) for camera in found]


def _rescaled(camera: Camera, vertices: AnyFloat, focal: float) -> Camera:
    """The camera with another focal length, and the middle of the head in the middle of the picture."""
    low, high = vertices.min(0).astype(np.float64), vertices.max(0).astype(np.float64)
    middle = camera.to_camera(((low + high) / 2)[None])[0]
    size = np.array([camera.width, camera.height]) / 2
    return dataclasses.replace(camera, focal_px=focal, principal_point=size - focal * middle[:2] / middle[2])


def gif(pictures: Sequence[UInt8]) -> bytes:
    """An endless GIF of pictures (h, w, 3) uint8 sRGB, with one palette, as several would flicker."""
    import io

    from PIL import Image

    frames = [Image.fromarray(picture) for picture in pictures]
    strip = Image.fromarray(np.concatenate([picture[::4, ::4] for picture in pictures]))
    palette = strip.quantize(256, method=Image.Quantize.MEDIANCUT)
    shown = [frame.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG) for frame in frames]
    stream = io.BytesIO()
    shown[0].save(
        stream, "GIF", save_all=True, append_images=shown[1:], loop=0, optimize=False,
        duration=max(round(1000 * SECONDS / len(pictures)), 20),
    )  # fmt: skip
    return stream.getvalue()


def mp4(pictures: Sequence[UInt8]) -> bytes:
    """An MP4 (MPEG-4 part 2, which OpenCV's wheels can write) of pictures (h, w, 3) uint8 sRGB.

    Raises:
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


def _decoded(png: bytes) -> UInt8:
    import cv2

    return np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR_RGB), np.uint8)


