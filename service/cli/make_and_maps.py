"""``avatarme make`` and ``avatarme maps``: photos of one person, or a mesh and its texture, in; an archive out."""

from __future__ import annotations

import hashlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from service.cli.files import check_paths, head_file, progress_bar, read_file
from service.errors import AvatarError, UnsupportedFormat, UsageError
from service.hair.asked import parse_hair, parse_length
from service.options import Options, parse_face, parse_maps, parse_size, parse_texture_size, parse_without
from service.photo.limits import PIPE, called, read_photo_file
from service.photo.video import VideoLimits, is_video

if TYPE_CHECKING:
    from service.archive.avatar import Avatar

_PARSERS: dict[str, Callable[[str], Any]] = {
    "maps": parse_maps,
    "size": parse_size,
    "texture_size": parse_texture_size,
    "face": parse_face,
    "without": parse_without,
    "hair": parse_hair,
    "hair_length": parse_length,
}


def asked(**flags: Any) -> dict[str, Any]:
    """Fields of :class:`Options` whose flags were given (are not None).

    Raises:
        UsageError: a value is out of range or cannot be read.
    """
    given = {name: value for name, value in flags.items() if value is not None}
    fields = {name: _PARSERS[name](value) if name in _PARSERS else value for name, value in given.items()}
    Options(**fields)
    return fields


def as_json(fields: dict[str, Any]) -> dict[str, Any]:
    """Fields of :class:`Options` as JSON values."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in fields.items()}


def destination(sources: Sequence[str], output: str | None, *, as_json: bool) -> str:
    """Path of the archive, or ``-``: as given, else beside the first photo, or standard output for one from a pipe.

    Raises:
        UsageError: the archive would overwrite a photo, share standard output with the JSON, or fill a terminal; or
            several photos come from standard input.
    """
    if output is None:
        output = PIPE if sources[0] == PIPE else str(Path(sources[0]).with_suffix(".zip"))
    names = ["photo"] if len(sources) == 1 else [f"photo {number}" for number in range(1, len(sources) + 1)]
    check_paths(output, dict(zip(names, sources, strict=True)), what="archive", example="OUT.zip", as_json=as_json)
    return output


def make(
    photos: Sequence[str], output: str | None, options: Options, *, video: str | None = None, head: str | None = None,
    as_json: bool,
) -> None:  # fmt: skip
    """Read photos of one person, run the pipeline, write the archive, report the result.

    Args:
        photos: paths, or ``-`` for standard input.
        output: path, ``-`` for standard output, or None for beside the first photo.
        options: the request.
        video: path of a video of the same person, or None.
        head: path of a head model file, None for the shipped one.
        as_json: print facts of the run as one JSON object instead of the path.

    Raises:
        UsageError: there is no head model file of that name, or neither photo nor video.
        AvatarError: as the stages raise it.
    """
    begin = time.perf_counter()
    if not photos and video is None:
        raise UsageError("there is no photo; name one or more of a person, or a video by --video", field="photos")
    target = destination([*photos, *([video] if video else [])], output, as_json=as_json)
    model = head_file(head)
    data = [read_photo_file(photo) for photo in photos]
    if video is not None:
        data.append(read_file(video, VideoLimits().max_bytes, "video"))
        photos = [*photos, video]
        if not is_video(data[-1]):
            raise UnsupportedFormat(f"{called(video)} is no video that is read: MP4, QuickTime and WebM are")
    with progress_bar() as progress, naming(photos):
        # After the cheap checks, as importing the numeric libraries takes a large part of a second.
        from service.archive.pack import write_archive
        from service.pipeline import make_avatar

        avatar = make_avatar(data, options, progress, model)
        write_archive(avatar, sys.stdout.buffer if target == PIPE else Path(target))
    seconds = time.perf_counter() - begin
    for code in avatar.all_warnings():
        typer.echo(f"avatarme: warning: {code}", err=True)
    names = {hashlib.sha256(content).hexdigest(): called(photo) for content, photo in zip(data, photos, strict=True)}
    for one in avatar.left_out:
        typer.echo(f"avatarme: {names.get(one.sha256, one.sha256)} is left out: {one.message}", err=True)
    if as_json:
        typer.echo(json.dumps(summary(avatar, target, seconds, names), allow_nan=False))
    elif target != PIPE:
        typer.echo(os.fsencode(target))  # bytes, as a file name need not be valid text


@contextmanager
def naming(photos: Sequence[str]) -> Iterator[None]:
    """Put the names of files into errors that concern one or some of several photos."""
    try:
        yield
    except AvatarError as error:
        numbers = error.extra.get("photos", [error.extra["photo"]] if "photo" in error.extra else [])
        if numbers:
            files = list(dict.fromkeys(called(photos[min(number, len(photos) - 1)]) for number in numbers))
            error.extra["files"] = files
            error.message = f"{', '.join(files)}: {error.message}"
            error.args = (error.message,)
        raise


def summary(avatar: Avatar, target: str, seconds: float, names: Mapping[str, str]) -> dict[str, Any]:
    """Facts of a run as JSON values: ``archive``, ``bytes``, ``seconds``, ``fit``, ``photos``, ``warnings`` ...

    ``names`` of the photos by the hashes of their bytes.
    """
    yaw, pitch, roll = avatar.fit.camera.yaw_pitch_roll_deg()
    return {
        "archive": target,
        "bytes": os.stat(target).st_size,
        "seconds": round(seconds, 3),
        "options": avatar.options,
        "fit": {
            "landmark_rms_px": avatar.fit.landmark_rms_px,
            "inter_ocular_px": avatar.fit.inter_ocular_px,
            "focal_px": avatar.fit.camera.focal_px,
            "yaw_pitch_roll_deg": [yaw, pitch, roll],
        },
        "photos": [
            {"file": names.get(one.photo.sha256, ""), "used_for": list(one.used_for), "texture_share": one.share}
            for one in avatar.sources
        ],
        "left_out": [
            {"file": names.get(one.sha256, ""), "code": one.code, "message": one.message} for one in avatar.left_out
        ],
        "warnings": list(avatar.all_warnings()),
        "timings_s": dict(avatar.timings_s),
        "peak_rss_mb": avatar.peak_rss_mb,
    }


MAX_TEXTURE = 200_000_000
MAX_MESH = 64 << 20
"""Largest input files, bytes."""


def maps(
    texture: str, mesh: str, output: str, options: dict[str, Any], *, head: str | None, as_json: bool
) -> None:  # fmt: skip
    """Read both, run the networks, write the archive, report the result.

    Args:
        texture: path of the image, or ``-`` for standard input.
        mesh: path of the mesh, or ``-``.
        output: path of the archive, or ``-`` for standard output.
        options: fields of :class:`Options` that were given.
        head: path of a head model file, None for the shipped one.
        as_json: print facts of the run as one JSON object instead of the path.

    Raises:
        UsageError: a file does not exist, both come from standard input, or an option is out of range.
        AvatarError: as the stages raise it.
    """
    begin = time.perf_counter()
    inputs = {"texture": texture, "mesh": mesh}
    check_paths(output, inputs, what="archive", example="OUT.zip", as_json=as_json)
    chosen_head = head_file(head)
    image, model = read_file(texture, MAX_TEXTURE, "texture"), read_file(mesh, MAX_MESH, "mesh")
    with progress_bar() as progress:
        from service.archive.pack import write_archive
        from service.external import external_maps, make_external, mesh_type

        chosen = Options(**{"maps": external_maps(), **options})
        avatar = make_external(image, model, chosen, progress, chosen_head, mesh_type(mesh, model))
        write_archive(avatar, sys.stdout.buffer if output == PIPE else Path(output))
    for code in avatar.all_warnings():
        typer.echo(f"avatarme: warning: {code}", err=True)
    if as_json:
        facts = {
            "archive": output,
            "bytes": os.stat(output).st_size,
            "seconds": round(time.perf_counter() - begin, 3),
            "options": dict(avatar.options),
            "warnings": list(avatar.all_warnings()),
            "fallbacks": [] if avatar.reflectance is None else list(avatar.reflectance.fallbacks),
            "timings_s": dict(avatar.timings_s),
            "peak_rss_mb": avatar.peak_rss_mb,
        }
        typer.echo(json.dumps(facts, allow_nan=False))
    elif output != PIPE:
        typer.echo(os.fsencode(output))
