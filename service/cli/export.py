"""``avatarme export``: an archive in, a kit for a tool out."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import typer


def export(archive: str, tool: str, output: str | None, *, as_json: bool) -> None:
    """Write the kit and print its folder.

    Args:
        archive: path.
        tool: one of ``service.kits.tools.TOOLS``.
        output: folder; None for one beside the archive, named after both.
        as_json: print facts as one JSON object instead.

    Raises:
        AvatarError: as ``service.kits.make.export_kit``.
    """
    from service.kits.make import export_kit

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
