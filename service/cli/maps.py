"""``avatarme maps``: external mesh and texture in, archive out."""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import typer

from service.cli.files import check_paths, head_file, read_file
from service.cli.progress import progress_bar
from service.photo.source import PIPE

MAX_TEXTURE = 200_000_000
MAX_MESH = 64 << 20
"""Largest input files, bytes."""


def maps(
    texture: str, mesh: str, output: str, options: dict[str, Any], *, head: str | None, as_json: bool
) -> None:  # fmt: skip
    """Read both, run the networks, write the archive, report the result.

    Args:
        texture: path of the image, or ``-`` for standard input.
        mesh: path of the OBJ file, or ``-``.
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
        from service.external.make import default_maps, make_external
        from service.options import Options

        chosen = Options(**{"maps": default_maps(), **options})
        avatar = make_external(image, model, chosen, progress, chosen_head)
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
