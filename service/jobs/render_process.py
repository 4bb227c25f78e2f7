"""The child process that renders one picture for the server under resource limits: one archive, one scene, one PNG."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from service.jobs.process import Program, Reporter, Task, serve_one


def load() -> Program:
    """Import the renderer."""
    import service.archive.rendering  # noqa: F401

    return run


def run(task: Task, reporter: Reporter) -> None:
    """Write the PNG to ``task.output`` and report ``done`` with the facts.

    Args:
        task: its options are ``archive``, the artifact's name, and ``request``, as ``parse_request`` wants it.
        reporter: for the answer.

    Raises:
        AvatarError: as ``service.archive.rendering.render_archive``.
    """
    from service.archive.images import encode_png
    from service.archive.rendering import render_archive
    from service.jobs.artifacts import Artifacts
    from service.render.request import parse_request

    with Artifacts(task.artifacts).open(str(task.options["archive"])) as stream:
        picture = render_archive(stream, parse_request(task.options["request"]))
    png = encode_png(picture.pixels, srgb=True)
    Path(task.output).write_bytes(png)
    reporter.done({**picture.facts(), "bytes": len(png)})


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does, and before numpy is imported
    sys.exit(serve_one(load))
