"""The program that makes one kit for the server under resource limits: one archive, one tool, one zip."""

from __future__ import annotations

from pathlib import Path

from service.archive.container import write_folder
from service.jobs.artifacts import Artifacts
from service.jobs.process import Reporter, Task
from service.kits.export import export_kit


def run(task: Task, reporter: Reporter) -> None:
    """Write the zip to ``task.output`` and report ``done`` with the names of its files.

    Args:
        task: its options are ``archive``, the artifact's name, and ``request``, whose ``for`` is one of
            ``service.kits.export.TOOLS``.
        reporter: for the answer.

    Raises:
        AvatarError: as ``service.kits.export.export_kit``.
    """
    scratch = Path(task.scratch)
    archive = Artifacts(task.artifacts).local(str(task.options["archive"]), scratch)
    kit = export_kit(archive, str(task.options["request"]["for"]), scratch / "kit")
    write_folder(Path(task.output), kit.folder, kit.files)
    reporter.done({"files": kit.facts()["files"]})
