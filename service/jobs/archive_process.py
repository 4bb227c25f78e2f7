"""The program that makes something of one archive for the server under resource limits: a picture, or a tool's kit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from service.jobs.artifacts import Artifacts
from service.jobs.process import Reporter, Task


def run(task: Task, reporter: Reporter) -> None:
    """Write the PNG or the zip to ``task.output`` and report ``done`` with the facts; raises what making it raises.

    The task's options are ``archive``, the artifact's name, and ``request``: ``for`` a tool of
    ``service.kits.export.TOOLS``, or a picture, as ``parse_request`` wants it.
    """
    request = task.options["request"]
    reporter.done((_kit if "for" in request else _picture)(task, request))


def _picture(task: Task, request: dict[str, Any]) -> dict[str, Any]:
    from service.archive.images import encode_png
    from service.archive.rendering import render_archive
    from service.render.request import parse_request

    with Artifacts(task.artifacts).open(str(task.options["archive"])) as stream:
        picture = render_archive(stream, parse_request(request))
    png = encode_png(picture.pixels, srgb=True)
    Path(task.output).write_bytes(png)
    return {**picture.facts(), "bytes": len(png)}


def _kit(task: Task, request: dict[str, Any]) -> dict[str, Any]:
    from service.archive.container import write_folder
    from service.kits.export import export_kit

    scratch = Path(task.scratch)
    archive = Artifacts(task.artifacts).local(str(task.options["archive"]), scratch)
    kit = export_kit(archive, str(request["for"]), scratch / "kit")
    write_folder(Path(task.output), kit.folder, kit.files)
    return {"files": kit.facts()["files"]}
