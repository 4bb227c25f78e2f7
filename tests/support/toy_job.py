"""A job that takes no time: a few stages that are kept like those of the pipeline, and faults on request.

The service runs it in place of the pipeline (``Settings.program``) where the service itself is measured or tested. The
seed of the options chooses a fault, see ``FAULTS``; every other seed makes a small archive.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import signal
import time
import zipfile
from pathlib import Path

import numpy as np
import numpy.typing as npt

from service.errors import NoFace, NumericFault
from service.jobs.process import Reporter, Task

STAGES = ("one", "two", "three")

FAULTS = {
    101: "crash in native code",
    102: "memory without end",
    103: "no end",
    104: "no face",
    105: "mistake in the program",
    106: "crash in native code, the first time only",
    107: "killed by somebody",
    108: "memory without end, unless it has to get by with less",
    109: "a number that is none",
}

SECONDS = "AVATARME_TOY_SECONDS"
"""Variable with the seconds that each stage takes."""

BUSY = "AVATARME_TOY_BUSY"
"""Variable that makes a stage compute for its time rather than sleep."""

LOG = "AVATARME_TOY_LOG"
"""Variable with the path of a file that gets a line for each stage begun or kept: ``tests.support.moments``."""


def archive(photo_sha256: str, seed: int) -> bytes:
    """What an undisturbed run makes."""
    value = np.zeros(0, np.int64)
    for name in STAGES:
        value = _stage(name, photo_sha256, seed, value)
    name, content = "maps/texture.png", value.tobytes()
    listed = {"path": name, "size": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    manifest = json.dumps({"files": [listed]}).encode()
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as zipped:
        for path, data in (("manifest.json", manifest), (name, content)):
            zipped.writestr(zipfile.ZipInfo(path, (1980, 1, 1, 0, 0, 0)), data)
    return stream.getvalue()


def run(task: Task, reporter: Reporter) -> None:
    """Compute the stages, or do what the seed says.

    Raises:
        NoFace, NumericFault, RuntimeError: on request.
    """
    from service.jobs.artifacts import Artifacts
    from service.jobs.stage_files import KeptStages

    seed = int(task.options["seed"])
    _fault(
        102 if seed == 108 and not task.tight else seed,
        Path(task.artifacts.removeprefix("file://")).parent / f"once-{task.job}",
    )
    digest = hashlib.sha256(Path(task.photo).read_bytes()).hexdigest()
    stages = KeptStages(
        Artifacts(task.artifacts), task.stages or task.job, f"{digest} {seed}", {}, Path(task.scratch),
        lambda name: _note(task.job, "kept", name),
    )
    value = np.zeros(0, np.int64)
    for number, name in enumerate(STAGES):
        reporter.progress(name, number / len(STAGES))
        before = value

        def make(name: str = name, before: npt.NDArray[np.int64] = before) -> npt.NDArray[np.int64]:
            _note(task.job, "begin", name)
            _spend(float(os.environ.get(SECONDS, "0.02")))
            return _stage(name, digest, seed, before)

        value = stages.get_or_compute(name, make)
    content = archive(digest, seed)
    Path(task.output).write_bytes(content)
    facts = {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}
    warnings = ["toy", "small-tiles"] if task.tight else ["toy"]
    reporter.done({**facts, "warnings": warnings, "timings": {"one": 0.01}, "peak_rss_mb": 1.0})


def _stage(name: str, photo_sha256: str, seed: int, before: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    key = hashlib.sha256(f"{name} {photo_sha256} {seed} {before.tobytes().hex()}".encode()).digest()
    return np.random.default_rng(list(key)).integers(0, 2**40, 4096)


def _fault(seed: int, mark: Path) -> None:
    if seed == 101 or (seed == 106 and not mark.exists()):
        mark.touch()
        os.kill(os.getpid(), signal.SIGSEGV)
    if seed == 102:
        hoard = []
        while True:
            hoard.append(bytearray(os.urandom(1 << 20) * 32))
    if seed == 103:
        while True:
            time.sleep(1)
    if seed == 104:
        raise NoFace("no face was found in the photo")
    if seed == 105:
        raise RuntimeError("a secret path: /etc/shadow")
    if seed == 109:
        raise NumericFault("network of a secret path: output has 1 of 16 values that are NaN or Inf")
    if seed == 107:
        os.kill(os.getpid(), signal.SIGKILL)


def _spend(seconds: float) -> None:
    if not os.environ.get(BUSY):
        time.sleep(seconds)
        return
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        hashlib.sha256(bytes(1 << 16)).digest()


def _note(job: str, what: str, stage: str) -> None:
    path = os.environ.get(LOG)
    if path:
        with open(path, "a", encoding="ascii") as log:
            log.write(f"{job} {what} {stage} {os.getpid()}\n")
