"""``avatarme make`` and ``avatarme maps``: photos of one person, or a mesh and its texture, in; an archive out."""

from __future__ import annotations

import gc
import hashlib
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.ahead import FaceNetworks
from service.cli.files import check_paths, expect_output, head_file, progress_bar, tell_result
from service.cli.flags import AVATAR, MAPS, Head, Json, asked, with_flags
from service.diagnosis import peak_rss_mb
from service.errors import AvatarError, UsageError
from service.options import Options
from service.photo.gate import expect_photo
from service.photo.limits import PIPE, called, read_file
from service.photo.video import MAX_VIDEO_BYTES, expect_video
from service.words import WORDS

if TYPE_CHECKING:
    from service.archive.avatar import Avatar


def destination(sources: Sequence[str], output: str | None, *, as_json: bool) -> str:
    """Path of the archive, or ``-``: as given, else beside the first photo, or standard output for one from a pipe.

    UsageError: as :func:`check_paths`.
    """
    if output is None:
        output = PIPE if sources[0] == PIPE else str(Path(sources[0]).with_suffix(".zip"))
    names = ["photo"] if len(sources) == 1 else [f"photo {number}" for number in range(1, len(sources) + 1)]
    check_paths(output, dict(zip(names, sources, strict=True)), what="archive", example="OUT.zip", as_json=as_json)
    return output


@with_flags(AVATAR)
def make(
    photos: Annotated[
        list[str] | None,
        typer.Argument(metavar="PHOTO...", help="1 to 24 photos of one person: JPEG, PNG, WebP, HEIC; - for a pipe."),
    ] = None,
    video: Annotated[
        str | None, typer.Option(metavar="FILE", help="A video in which the person turns the head: MP4, MOV, WebM.")
    ] = None,
    output: Annotated[
        str | None, typer.Option("-o", "--output", help="Archive to write, or - for a pipe. [default: beside PHOTO]")
    ] = None,
    head: Head = None,
    as_json: Json = False,
    **flags: Any,
) -> None:
    """Make an avatar from photos of one person, in any order.

    Prints the path of the archive. Exit status: 0 done, 2 usage, 3 no usable face, 4 unreadable input, 1 anything else.
    """
    begin, options = time.perf_counter(), Options(**asked(flags))
    files = [*(photos or ()), *([] if video is None else [video])]
    if not files:
        raise UsageError("there is no photo; name one or more of a person, or a video by --video", field="photos")
    target = destination(files, output, as_json=as_json)
    model = head_file(head)
    data = [read_file(photo) for photo in photos or ()]
    if video is not None:
        data.append(read_file(video, "video", MAX_VIDEO_BYTES))
        expect_video(data[-1], called(video))
    expect_output(target)
    with progress_bar() as progress, naming(files):
        # After the cheap checks, as importing the program takes a large part of a second; meanwhile others begin.
        expect_photo()
        networks = FaceNetworks(options, model)
        from service.archive.pack import write_archive
        from service.pipeline import make_avatar

        gc.freeze()  # to look through what the libraries made again and again would take a fiftieth of a draft
        avatar = make_avatar(data, options, progress, model, loaded=networks)
        write_archive(avatar, sys.stdout.buffer if target == PIPE else Path(target))
    seconds = time.perf_counter() - begin
    names = {hashlib.sha256(content).hexdigest(): called(file) for content, file in zip(data, files, strict=True)}
    told(avatar, target, lambda: summary(avatar, target, seconds, names), as_json=as_json)
    for one in avatar.left_out:
        typer.echo(f"avatarme: {names.get(one.sha256, one.sha256)} is left out: {one.message}", err=True)


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


def told(avatar: Avatar, target: str, facts: Callable[[], dict[str, Any]], *, as_json: bool) -> None:
    """Say what to look at, and the path of the archive, or facts of the run as one JSON object."""
    for code in avatar.all_warnings():
        typer.echo(f"avatarme: warning: {code}: {WORDS['warnings'][code]}", err=True)
    tell_result(target, facts() if as_json else {}, as_json=as_json)


def run_facts(avatar: Avatar, target: str, seconds: float) -> dict[str, Any]:
    """Facts of any run as JSON values."""
    return {
        "archive": target,
        "bytes": os.stat(target).st_size,
        "seconds": round(seconds, 3),
        "options": dict(avatar.options),
        "warnings": list(avatar.all_warnings()),
        "timings_s": dict(avatar.timings_s),
        "peak_rss_mb": peak_rss_mb(),
    }


def summary(avatar: Avatar, target: str, seconds: float, names: Mapping[str, str]) -> dict[str, Any]:
    """Facts of a run on photos, whose ``names`` go by the hashes of their bytes."""
    camera = avatar.fit.camera
    left = [{"file": names.get(one.sha256, ""), "code": one.code, "message": one.message} for one in avatar.left_out]
    return run_facts(avatar, target, seconds) | {
        "fit": {
            "landmark_rms_px": avatar.fit.landmark_rms_px,
            "inter_ocular_px": avatar.fit.inter_ocular_px,
            "focal_px": camera.focal_px,
            "yaw_pitch_roll_deg": list(camera.yaw_pitch_roll_deg()),
        },
        "photos": [
            {"file": names.get(one.photo.sha256, ""), "used_for": list(one.used_for), "texture_share": one.share}
            for one in avatar.sources
        ],
        "left_out": left,
    }


@with_flags(MAPS)
def maps(
    texture: Annotated[str, typer.Option(metavar="T.png", help="Texture on the head's chart, 3:2, or - for a pipe.")],
    mesh: Annotated[
        str, typer.Option(metavar="HEAD.obj", help="Mesh (OBJ, GLB, PLY ...) with the topology of mesh/head.obj, or -.")
    ],
    output: Annotated[str, typer.Option("-o", "--output", metavar="OUT.zip", help="Archive to write, or -.")],
    head: Head = None,
    as_json: Json = False,
    **flags: Any,
) -> None:
    """Make reflectance maps for an external mesh and texture, without a photo.

    Exit status: 0 done, 2 usage, 4 texture or mesh cannot be used, 1 anything else.
    """
    begin, options = time.perf_counter(), asked(flags)
    check_paths(output, {"texture": texture, "mesh": mesh}, what="archive", example="OUT.zip", as_json=as_json)
    chosen_head = head_file(head)
    image, model = read_file(texture, "texture", 200_000_000), read_file(mesh, "mesh", 64 << 20)
    expect_output(output)
    with progress_bar() as progress:
        from service.archive.pack import write_archive
        from service.external import external_maps, make_external, mesh_type

        chosen = Options(**{"maps": external_maps(), **options})
        avatar = make_external(image, model, chosen, progress, chosen_head, mesh_type(mesh, model))
        write_archive(avatar, sys.stdout.buffer if output == PIPE else Path(output))
    seconds, made = time.perf_counter() - begin, avatar.reflectance
    fallbacks = [] if made is None else list(made.fallbacks)
    told(avatar, output, lambda: run_facts(avatar, output, seconds) | {"fallbacks": fallbacks}, as_json=as_json)
