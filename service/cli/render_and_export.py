"""``avatarme render`` and ``avatarme export``: an archive in; a picture, a film or a kit for a tool out."""

from __future__ import annotations

import io
import json
import os
import time
from pathlib import Path
from typing import IO, TYPE_CHECKING

import typer

from service.cli.files import check_paths, progress_bar, read_file, write_bytes
from service.errors import UsageError
from service.light.scene import Scene
from service.photo.limits import PIPE

if TYPE_CHECKING:
    from service.render.request import RenderRequest

MAX_SCENE = 1 << 20
MAX_ARCHIVE = 2 << 30
"""Largest inputs, bytes; of archives only those from standard input."""


def render(
    archive: str, output: str, *, scene: str | None, size: tuple[int, int] | None, view: str | None,
    background: str | None, samples: int | None, tolerance: float | None, turntable: int | None, as_json: bool,
) -> None:  # fmt: skip
    """Render, write the PNG, report on standard error which effects were computed and which left out.

    Args:
        archive: path, or ``-`` for standard input.
        output: path, or ``-`` for standard output.
        scene: path of a JSON file, or ``-``; None for the studio.
        size: (width, height) in pixels.
        view: see ``RenderRequest``, as ``background``, ``samples`` and ``tolerance``; None for the default.
        background: behind the head.
        samples: per pixel and axis.
        tolerance: largest mean error by leaving out effects, in 1/255 of sRGB.
        turntable: pictures of a film around the head; None for one picture.
        as_json: print facts as one JSON object instead of the path.

    Raises:
        UsageError: a file does not exist, or an option or a field of the scene is out of range.
        AvatarError: the archive cannot be used.
    """
    begin = time.perf_counter()
    inputs = {"archive": archive, **({} if scene is None else {"scene": scene})}
    check_paths(output, inputs, what="picture", example="IMAGE.png", as_json=as_json)
    text = None if scene is None else read_file(scene, MAX_SCENE, "scene").decode("utf-8", "replace")
    given = {
        "scene": None if text is None else Scene.from_json(text), "size": size, "view": view,
        "background": background, "samples": samples, "tolerance": tolerance,
    }  # fmt: skip
    from service.archive.images import encode_png
    from service.archive.rendering import render_archive
    from service.light.plan import report
    from service.render.request import RenderRequest

    request = RenderRequest(**{name: value for name, value in given.items() if value is not None})  # type: ignore[arg-type]
    if turntable is not None:
        _film(archive, output, request, turntable, begin, as_json=as_json)
        return
    source: Path | IO[bytes] = io.BytesIO(read_file(PIPE, MAX_ARCHIVE, "archive")) if archive == PIPE else Path(archive)
    picture = render_archive(source, request)
    png = encode_png(picture.pixels, srgb=True)
    write_bytes(output, png)
    typer.echo(report(picture.plan), err=True)
    for code in picture.fallbacks:
        typer.echo(f"avatarme: fallback: {code}", err=True)
    if as_json:
        seconds = round(time.perf_counter() - begin, 3)
        facts = {"image": output, "bytes": len(png), **picture.facts(), "seconds": seconds}
        typer.echo(json.dumps(facts, allow_nan=False))
    elif output != PIPE:
        typer.echo(os.fsencode(output))


def _film(
    archive: str, output: str, request: RenderRequest, count: int, begin: float, *, as_json: bool
) -> None:
    """Render a turntable, with a progress bar, and report it."""
    from service.archive.rendering import turntable

    if PIPE in (archive, output):
        raise UsageError("a turntable is made from a file to a file, not through pipes", field="turntable")
    with progress_bar() as progress:
        size = turntable(Path(archive), Path(output), request, count, progress)
    if as_json:
        facts = {"film": output, "pictures": count, "bytes": size, "seconds": round(time.perf_counter() - begin, 3)}
        typer.echo(json.dumps(facts, allow_nan=False))
    else:
        typer.echo(os.fsencode(output))


def export(archive: str, tool: str, output: str | None, *, as_json: bool) -> None:
    """Write the kit and print its folder.

    Args:
        archive: path.
        tool: one of ``service.kits.export.TOOLS``.
        output: folder; None for one beside the archive, named after both.
        as_json: print facts as one JSON object instead.

    Raises:
        AvatarError: as ``service.kits.export.export_kit``.
    """
    from service.kits.export import export_kit

    begin = time.perf_counter()
    source = Path(archive)
    folder = source.with_name(f"{source.stem}-{tool}") if output is None else Path(output)
    kit = export_kit(source, tool, folder)
    if tool == "blender" and kit.scene is None:
        typer.echo("avatarme: Blender is not installed here; run avatar_scene.py in Blender, docs/blender.md", err=True)
    if as_json:
        typer.echo(json.dumps({**kit.facts(), "seconds": round(time.perf_counter() - begin, 3)}, allow_nan=False))
    else:
        typer.echo(os.fsencode(str(kit.folder)))
