"""``avatarme maps``: a texture and a mesh in, the archive of a head of one's own out."""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import typer

from service.cli.files import PIPE, read_file
from service.cli.progress import progress_bar
from service.errors import UsageError

MAX_TEXTURE = 200_000_000
MAX_MESH = 64 << 20


def maps(
    texture: str, mesh: str, output: str, options: dict[str, Any], *, head: str | None, as_json: bool
) -> None:  # fmt: skip
    """Read both, run the networks, write the archive, say what came of it.

    Args:
        texture: path of the image, or ``-`` for standard input.
        mesh: path of the OBJ file, or ``-``.
        output: path of the archive, or ``-`` for standard output.
        options: fields of :class:`Options` that were asked for.
        head: path of a head model file, None for the one in the box.
        as_json: print facts of the run as one JSON object instead of the path.

    Raises:
        UsageError: a file is not there, both come from one pipe, or an option is out of range.
        AvatarError: whatever a stage found wrong.
    """
    begin = time.perf_counter()
    _check_pipes(texture, mesh, output, as_json=as_json)
    head_file = None if head is None else Path(head)
    if head_file is not None and not head_file.is_file():
        raise UsageError(f"there is no head model file {head}; docs/head-model.md says how one is made", field="head")
    image, model = read_file(texture, MAX_TEXTURE, "texture"), read_file(mesh, MAX_MESH, "mesh")
    with progress_bar() as progress:
        from service.archive.pack import write_archive
        from service.external.make import default_maps, make_own
        from service.options import Options

        chosen = Options(**{"maps": default_maps(), **options})
        avatar = make_own(image, model, chosen, progress, head_file)
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


def _check_pipes(texture: str, mesh: str, output: str, *, as_json: bool) -> None:
    if texture == PIPE and mesh == PIPE:
        raise UsageError("texture and mesh cannot both come from standard input; name a file for one of them")
    if output == PIPE and as_json:
        raise UsageError("--json and the archive cannot both go to standard output; name a file with -o OUT.zip")
    if output == PIPE and sys.stdout.isatty():
        raise UsageError("standard output is a terminal; name a file with -o OUT.zip, or redirect it")
    for name in (texture, mesh):
        both = output != PIPE and name != PIPE and os.path.exists(output) and os.path.exists(name)
        if both and os.path.samefile(output, name):
            raise UsageError(f"{output} is what is read; name another file with -o OUT.zip")
