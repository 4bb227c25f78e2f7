"""The process of a worker that makes shards of batches beside jobs: ``python -m service.batch.worker``."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from service.batch.makers import LocalMaker
from service.batch.shards import Rounds, Shards
from service.jobs.worker import Worker, main
from service.jobs.workflow import Workflows

LOOKS = 4
"""How often a worker looks for a shard while it would look for a job once: it makes one after the other."""


def batches(worker: Worker) -> Sequence[Workflows]:
    """What a worker does besides jobs."""
    settings, runner = worker.settings, worker.runner
    rounds, scratch = Rounds(worker.engine), runner.scratch / "batches"
    shards = Shards(rounds, LocalMaker(settings), scratch, runner.stopping, lambda error: worker.quit(error.message))
    return [shards.workflows(settings.batches, settings.look_seconds / LOOKS)]


if __name__ == "__main__":
    sys.exit(main(batches))
