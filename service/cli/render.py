"""``avatarme render``: an archive and a scene in, a picture out."""

from __future__ import annotations

import io
import json
import os
import sys
import time
from pathlib import Path
from typing import IO

import typer

from service.cli.files import PIPE, read_file
from service.cli.output import write_bytes
from service.errors import UsageError
from service.light.scene import Scene

MAX_SCENE = 1 << 20
MAX_ARCHIVE = 2 << 30


def render(
    archive: str, output: str, *, scene: str | None, size: tuple[int, int] | None, view: str | None,
    background: str | None, samples: int | None, tolerance: float | None, as_json: bool,
) -> None:  # fmt: skip
    """Render, write the PNG, say on standard error what was computed and what was left out.

    Args:
        archive: path, or ``-`` for standard input.
        output: path, or ``-`` for standard output.
        scene: path of a JSON file, or ``-``; None for the studio.
        size: (width, height) in pixels.
        view: see ``RenderRequest``, as ``background``, ``samples`` and ``tolerance``; None for the default.
        background: behind the head.
        samples: per pixel and axis.
        tolerance: error in 1/255 that leaving out effects may cost.
        as_json: print facts as one JSON object instead of the path.

    Raises:
        UsageError: a file is not there, an option or a field of the scene is out of range.
        AvatarError: whatever is wrong with the archive.
    """
    begin = time.perf_counter()
    _check_pipes(archive, output, scene, as_json=as_json)
    text = None if scene is None else read_file(scene, MAX_SCENE, "scene").decode("utf-8", "replace")
    given = {
        "scene": None if text is None else Scene.from_json(text), "size": size, "view": view,
        "background": background, "samples": samples, "tolerance": tolerance,
    }  # fmt: skip
    from service.light.plan import report
    from service.render.render import render_archive
    from service.render.request import RenderRequest

    request = RenderRequest(**{name: value for name, value in given.items() if value is not None})  # type: ignore[arg-type]
    source: Path | IO[bytes] = io.BytesIO(read_file(PIPE, MAX_ARCHIVE, "archive")) if archive == PIPE else Path(archive)
    picture = render_archive(source, request)
    write_bytes(output, picture.png)
    typer.echo(report(picture.plan), err=True)
    for code in picture.fallbacks:
        typer.echo(f"avatarme: fallback: {code}", err=True)
    if as_json:
        facts = {"image": output, **picture.facts(), "seconds": round(time.perf_counter() - begin, 3)}
        typer.echo(json.dumps(facts, allow_nan=False))
    elif output != PIPE:
        typer.echo(os.fsencode(output))


def _check_pipes(archive: str, output: str, scene: str | None, *, as_json: bool) -> None:
    if archive == PIPE and scene == PIPE:
        raise UsageError("archive and scene cannot both come from standard input; name a file for one of them")
    if output == PIPE and as_json:
        raise UsageError("--json and the picture cannot both go to standard output; name a file with -o IMAGE.png")
    if output == PIPE and sys.stdout.isatty():
        raise UsageError("standard output is a terminal; name a file with -o IMAGE.png, or redirect it")
    for name in (archive, scene or PIPE):
        both = output != PIPE and name != PIPE and os.path.exists(output) and os.path.exists(name)
        if both and os.path.samefile(output, name):
            raise UsageError(f"{output} is what is read; name another file with -o IMAGE.png")
