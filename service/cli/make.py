"""``avatarme make``: one photo in, one archive out."""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from service.cli.files import head_file
from service.cli.progress import progress_bar
from service.cli.source import destination
from service.options import Options
from service.photo.source import PIPE, read_photo

if TYPE_CHECKING:
    from service.archive.avatar import Avatar


def make(photo: str, output: str | None, options: Options, *, head: str | None = None, as_json: bool) -> None:
    """Read ``photo``, run the pipeline, write the archive, report the result.

    Args:
        photo: path, or ``-`` for standard input.
        output: path, ``-`` for standard output, or None for beside the photo.
        options: the request.
        head: path of a head model file, None for the shipped one.
        as_json: print facts of the run as one JSON object instead of the path.

    Raises:
        UsageError: there is no head model file of that name.
        AvatarError: as the stages raise it.
    """
    begin = time.perf_counter()
    target = destination(photo, output, as_json=as_json)
    model = head_file(head)
    data = read_photo(photo)
    with progress_bar() as progress:
        # After the cheap checks, as importing the numeric libraries takes a large part of a second.
        from service.archive.pack import write_archive
        from service.pipeline import make_avatar

        avatar = make_avatar(data, options, progress, model)
        write_archive(avatar, sys.stdout.buffer if target == PIPE else Path(target))
    seconds = time.perf_counter() - begin
    for code in avatar.all_warnings():
        typer.echo(f"avatarme: warning: {code}", err=True)
    if as_json:
        typer.echo(json.dumps(summary(avatar, target, seconds), allow_nan=False))
    elif target != PIPE:
        typer.echo(os.fsencode(target))  # bytes, as a file name need not be valid text


def summary(avatar: Avatar, target: str, seconds: float) -> dict[str, Any]:
    """Facts of a run as JSON values: ``archive``, ``bytes``, ``seconds``, ``fit``, ``warnings``, ``timings_s``."""
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
        "warnings": list(avatar.all_warnings()),
        "timings_s": dict(avatar.timings_s),
        "peak_rss_mb": avatar.peak_rss_mb,
    }
