"""Finished stages of a job on disk, so that a killed run goes on after the last of them."""

from __future__ import annotations

import hashlib
import logging
import secrets
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

from service.jobs.artifacts import Artifacts, artifact_name
from service.jobs.packing import Damaged, pack, unpack

T = TypeVar("T")

log = logging.getLogger(__name__)


class KeptStages:
    """``service.stages.Stages`` for one job.

    A stage's file is named by a hash of everything that its result depends on: the program and its data, the photo, the
    options and the name of the stage. It begins with the hash of its content, so a torn or changed file is computed
    again; that is why it need not be flushed to the disk.

    Args:
        artifacts: where to.
        job: of which job.
        basis: whatever the results depend on, as text.
        kinds: dataclasses of the pipeline by name.
        scratch: a folder on this machine for files on their way.
        finished: told the name of each stage that was computed and kept.
    """

    def __init__(
        self,
        artifacts: Artifacts,
        job: str,
        basis: str,
        kinds: Mapping[str, type],
        scratch: Path,
        finished: Callable[[str], None] = lambda name: None,
    ) -> None:
        self._artifacts = artifacts
        self._job = job
        self._basis = basis
        self._kinds = kinds
        self._scratch = scratch
        self._finished = finished

    def keep(self, name: str, make: Callable[[], T]) -> T:
        """As :meth:`service.stages.Stages.keep`; a stage that cannot be written is logged and not kept."""
        key = hashlib.sha256(f"{self._basis}\n{name}".encode()).hexdigest()
        address = artifact_name(self._job, f"stage_{name}", key, "bin")
        try:
            with self._artifacts.open(address) as stream:
                kept: T = unpack(stream, self._kinds)
            return kept
        except FileNotFoundError:
            pass
        except Damaged as error:
            log.warning("stage %s is computed again: %s", name, error)
        value = make()
        part = self._scratch / f"{secrets.token_hex(8)}.part"
        try:
            with part.open("wb") as target:
                pack(value, self._kinds, target)
            self._artifacts.put(part, address, durable=False)
        except OSError as error:  # a full disk: the job may still get through
            log.warning("stage %s is not kept: %s", name, error)
            part.unlink(missing_ok=True)
        else:
            self._finished(name)
        return value
