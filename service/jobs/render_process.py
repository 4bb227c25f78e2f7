"""The program that renders one picture for the server under resource limits: one archive, one scene, one PNG."""

from __future__ import annotations

from pathlib import Path

from service.archive.images import encode_png
from service.archive.rendering import render_archive
from service.jobs.artifacts import Artifacts
from service.jobs.process import Reporter, Task
from service.render.request import parse_request


def run(task: Task, reporter: Reporter) -> None:
    """Write the PNG to ``task.output`` and report ``done`` with the facts.

    Args:
        task: its options are ``archive``, the artifact's name, and ``request``, as ``parse_request`` wants it.
        reporter: for the answer.

    Raises:
        AvatarError: as ``service.archive.rendering.render_archive``.
    """
    with Artifacts(task.artifacts).open(str(task.options["archive"])) as stream:
        picture = render_archive(stream, parse_request(task.options["request"]))
    png = encode_png(picture.pixels, srgb=True)
    Path(task.output).write_bytes(png)
    reporter.done({**picture.facts(), "bytes": len(png)})
