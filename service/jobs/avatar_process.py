"""The program that computes one photo, of a job or of a batch, with its stages kept where there is a store for them."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from service import GENERATOR, pipeline
from service.ahead import FaceNetworks
from service.archive.pack import write_archive
from service.diagnosis import DATA, SUMS, peak_rss_mb
from service.errors import CorruptImage
from service.jobs.artifacts import Artifacts
from service.jobs.process import Reporter, Task
from service.jobs.stage_files import FORMAT, KeptStages, kept_types
from service.options import CORRECTIONS, Options
from service.photo.bundle import MOST, unbundled
from service.photo.gate import expect_photo
from service.photo.limits import Limits, read_file
from service.places import file_sha256
from service.runtime.tiles import DEFAULT_TILE, SMALL_TILE
from service.stage_cache import NoCache, StageCache

HEAD = "head"
"""Key in the task's options that names another head model file, or null."""

NETWORKS = FaceNetworks(Options(quality="draft"), maps=pipeline.made_ahead)
"""Loaded by threads while the process waits for its one task."""

expect_photo()


def run(task: Task, reporter: Reporter) -> None:
    """Make the avatar, write the archive and say ``done``; raises as ``service.pipeline.make_avatar``."""
    data = read_file(task.photo, limit=MOST * Limits().max_bytes)
    if hashlib.sha256(data).hexdigest() != task.photo_sha256:
        raise CorruptImage("the photo was changed on the disk after it was taken; send it again")
    stages: StageCache = NoCache()
    if task.artifacts:
        stages = KeptStages(
            Artifacts(task.artifacts), task.stages or task.job, cache_basis(task), kept_types(pipeline),
            Path(task.scratch), finished=reporter.kept, mapped=task.tight,
        )  # fmt: skip
    asked = dict(task.options)
    head = asked.pop(HEAD, None)
    avatar = pipeline.make_avatar(
        unbundled(data), options_from(asked), reporter.progress, None if head is None else Path(str(head)), stages,
        SMALL_TILE if task.tight else DEFAULT_TILE, NETWORKS,
    )  # fmt: skip
    reporter.progress("pack", 0.9)
    output = Path(task.output)
    write_archive(avatar, output)
    reporter.done(
        {
            "sha256": file_sha256(output),
            "bytes": output.stat().st_size,
            "warnings": list(avatar.all_warnings()),
            "timings": {name: round(seconds, 4) for name, seconds in avatar.timings_s.items()},
            "peak_rss_mb": peak_rss_mb(),
        }
    )


def options_from(values: Any) -> Options:
    """JSON values of ``Options.to_json`` -> Options."""
    return TypeAdapter(Options).validate_python(values)


def cache_basis(task: Task) -> str:
    """What the results of all stages depend on, and how they are written: program, data files, photo, and the options
    that no correction changes.
    """
    sums = hashlib.sha256((DATA / SUMS).read_bytes()).hexdigest()
    options = {name: value for name, value in task.options.items() if name not in CORRECTIONS}
    return "\n".join((GENERATOR, FORMAT, sums, task.photo_sha256, json.dumps(options, sort_keys=True)))
