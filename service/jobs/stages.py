"""Finished stages of a job on disk, so that a killed run goes on after the last of them."""

from __future__ import annotations

import contextlib
import hashlib
import logging
import secrets
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar, cast

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
        mapped: results stay on the disk and are mapped into memory, which is then not used for what earlier stages
            made; they are the same to the last bit and cannot be changed.
    """

    def __init__(
        self,
        artifacts: Artifacts,
        job: str,
        basis: str,
        kinds: Mapping[str, type],
        scratch: Path,
        finished: Callable[[str], None] = lambda name: None,
        *,
        mapped: bool = False,
    ) -> None:
        self._artifacts = artifacts
        self._job = job
        self._basis = basis
        self._kinds = kinds
        self._scratch = scratch
        self._finished = finished
        self._mapped = mapped

    def keep(self, name: str, make: Callable[[], T]) -> T:
        """As :meth:`service.stages.Stages.keep`; a stage that cannot be read is computed, one that
        cannot be written is not kept; both are logged.
        """
        key = hashlib.sha256(f"{self._basis}\n{name}".encode()).hexdigest()
        address = artifact_name(self._job, f"stage_{name}", key, "bin")
        try:
            return cast(T, self._load(address))
        except FileNotFoundError:
            pass
        except (Damaged, OSError) as error:  # what a store cannot give out now can be made
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
            if self._mapped:
                with contextlib.suppress(OSError, Damaged):
                    return cast(T, self._load(address))
        return value

    def _load(self, address: str) -> Any:
        """The result in a file.

        Raises:
            FileNotFoundError: there is none.
            Damaged: as :func:`service.jobs.packing.unpack`.
        """
        with self._artifacts.open(address) as stream:
            if not self._mapped or self._artifacts.folder is not None:
                return unpack(stream, self._kinds, mapped=self._mapped)
            with (self._scratch / f"{secrets.token_hex(8)}.map").open("w+b") as copy:
                shutil.copyfileobj(stream, copy)
                copy.seek(0)
                return unpack(copy, self._kinds, mapped=True)
