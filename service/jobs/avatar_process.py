"""The process that computes one job: the pipeline, with finished stages kept on disk."""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path
from typing import Any

from service.jobs.process import Program, Reporter, Task, serve_one


def load() -> Program:
    """Import the pipeline; it takes a good part of a second."""
    import service.archive.pack
    import service.pipeline  # noqa: F401

    return run


def run(task: Task, reporter: Reporter) -> None:
    """Make the avatar, write the archive and say ``done``.

    Raises:
        AvatarError: as ``service.pipeline.make_avatar``.
    """
    from service import pipeline
    from service.archive.pack import write_archive
    from service.errors import CorruptImage
    from service.jobs.artifacts import Artifacts, sha256_of
    from service.jobs.stage_files import KeptStages, kept_types
    from service.runtime.tiles import DEFAULT_TILE, SMALL_TILE

    data = Path(task.photo).read_bytes()
    if hashlib.sha256(data).hexdigest() != task.photo_sha256:
        raise CorruptImage("the photo was changed on the server's disk after it was accepted; send it again")
    stages = KeptStages(
        Artifacts(task.artifacts),
        task.job,
        basis(task),
        kept_types(pipeline),
        Path(task.scratch),
        finished=reporter.kept,
        mapped=task.tight,
    )
    tile = SMALL_TILE if task.tight else DEFAULT_TILE
    avatar = pipeline.make_avatar(data, options_from(task.options), reporter.progress, stages=stages, tile=tile)
    reporter.progress("pack", 0.9)
    output = Path(task.output)
    write_archive(avatar, output)
    with output.open("rb") as stream:
        digest = sha256_of(stream)
    reporter.done(
        {
            "sha256": digest,
            "bytes": output.stat().st_size,
            "warnings": list(avatar.all_warnings()),
            "timings": {name: round(seconds, 4) for name, seconds in avatar.timings_s.items()},
            "peak_rss_mb": avatar.peak_rss_mb,
        }
    )


def options_from(values: Any) -> Any:
    """JSON values of ``Options.to_json`` -> Options."""
    from pydantic import TypeAdapter

    from service.options import Options

    return TypeAdapter(Options).validate_python(values)


def basis(task: Task) -> str:
    """What the results of stages depend on, and how they are written: program, data files, photo, options."""
    import json

    from service import GENERATOR
    from service.diagnosis import DATA, SUMS
    from service.jobs.settings import PIPELINE_VERSION
    from service.jobs.stage_files import FORMAT

    sums = hashlib.sha256((DATA / SUMS).read_bytes()).hexdigest()
    options = json.dumps(task.options, sort_keys=True)
    return "\n".join((GENERATOR, PIPELINE_VERSION, FORMAT, sums, task.photo_sha256, options))


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does, and before numpy is imported
    sys.exit(serve_one(load))
