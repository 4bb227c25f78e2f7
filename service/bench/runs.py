"""The benchmark: an avatar of the sample photo at every quality, on every runtime and at several sizes, in one run.

Absolute times differ between machines and over time; ratios hold, as everything is measured in the same run. Every
avatar is made as ``avatarme make`` makes it, in a process of its own, so that caches are cold and memory is its own.
"""

from __future__ import annotations

import platform
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from service import diagnosis
from service.bench.losses import FittedLine, Kind, decibels, line, loss_of, pareto
from service.errors import AvatarError, Crashed
from service.levels import FULL_SIZE, LEVELS
from service.options import Options
from service.runtime.networks import choose_engine
from service.runtime.sessions import has_openvino

T = TypeVar("T")
Launch = Callable[..., Any]
Progress = Callable[[str, float], None]

COMPARED: dict[str, Kind] = {
    "diffuse_albedo": "colour", "specular_albedo": "colour", "specular_normal": "normal", "diffuse_normal": "normal",
}  # fmt: skip
"""Maps whose loss is told."""

SHOWN = (5 / 16, 11 / 16, 3 / 8, 5 / 8)
"""The part of the chart on which maps are compared, where the face is: first and last row, first and last column."""

WRITING = "write"
"""Name of the time of writing the archive."""

SIZES = (1536, 3072, 6144)
QUICK_SIZES = (384, 768, 1536)
"""Widths of maps; through their times the line is drawn."""


@dataclass(frozen=True)
class Run:
    """What is made: ``label`` in words, and what is asked of ``make_avatar``."""

    label: str
    options: Options


@dataclass(frozen=True)
class Made:
    """What came of a run.

    Attributes:
        seconds: from the photo's bytes to the archive on the disk.
        timings_s: by stage.
        peak_mb: largest resident memory of the process, MiB.
        megabytes: of the archive.
        engines: runtime and precision of the networks, in words.
    """

    seconds: float
    timings_s: Mapping[str, float]
    peak_mb: float
    megabytes: float
    engines: str

    @property
    def networks_s(self) -> float:
        """Seconds of the networks that make maps."""
        return sum(self.timings_s.get(name, 0.0) for name in ("super_resolution", *COMPARED))


@dataclass(frozen=True)
class Row:
    """One run; ``losses`` by map against the last run, ``front`` where no other is faster and better; else a fault."""

    run: Run
    made: Made | None = None
    losses: Mapping[str, float] | None = None
    front: bool = False
    fault: str = ""


@dataclass(frozen=True)
class Bench:
    """All results: facts of the machine, the rows, seconds without super-resolution against megatexels, duration."""

    machine: Mapping[str, Any]
    rows: Sequence[Row]
    line: FittedLine | None
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """JSON values."""
        rows = [
            {
                "label": row.run.label, "options": row.run.options.to_json(), "fault": row.fault, "pareto": row.front,
                "made": None if row.made is None else asdict(row.made),
                "loss": {name: shown_loss(name, loss) for name, loss in (row.losses or {}).items()},
            }
            for row in self.rows
        ]  # fmt: skip
        fitted = None if self.line is None else asdict(self.line)
        return {"machine": dict(self.machine), "runs": rows, "line": fitted, "seconds": self.seconds}


def shown_loss(name: str, loss: float) -> float:
    """Decibels of a colour, degrees of a normal."""
    return decibels(loss) if COMPARED[name] == "colour" else loss


def runs(*, quick: bool) -> list[Run]:
    """What is made, the reference last. Qualities that are the same on this machine are still made each."""
    plain = Options(quality="draft", face="largest")
    if quick:
        return [Run(f"draft, {width} wide", _sized(plain, width)) for width in QUICK_SIZES]
    found = [Run("draft, onnxruntime", replace(plain, runtime="onnxruntime"))] if has_openvino() else []
    found += [Run(f"standard, {width} wide", _sized(replace(plain, quality="standard"), width)) for width in SIZES[:-1]]
    qualities: dict[str, Any] = {name: name for name in LEVELS}
    return found + [Run(name, replace(plain, quality=quality)) for name, quality in qualities.items()]


def _sized(options: Options, width: int) -> Options:
    return replace(options, size=(width, width * FULL_SIZE[1] // FULL_SIZE[0]))


def make(run: Run, photo: bytes, output: Path) -> Made:
    """Make an avatar and its archive, and write the face of its maps and the mask of skin to ``output`` (``.npz``).

    Raises:
        AvatarError: as ``service.pipeline.make_avatar``.
    """
    begin = time.perf_counter()
    from service.archive.pack import write_archive
    from service.pipeline import make_avatar
    from service.reflectance.subject import GEOMETRY_SIZE, Subject

    avatar = make_avatar(photo, run.options)
    writing = time.perf_counter()
    with tempfile.TemporaryDirectory() as scratch:
        target = Path(scratch) / "avatar.zip"
        write_archive(avatar, target)
        megabytes = target.stat().st_size / 1e6
    end = time.perf_counter()
    peak = diagnosis.peak_rss_mb()
    made = avatar.reflectance
    maps = {name: face_of(codes) for name in COMPARED if (codes := getattr(made, name, None)) is not None}
    subject = Subject.in_photo(avatar.head, avatar.fit, avatar.texture)
    skin = np.where(subject.chart.mask, subject.skin(GEOMETRY_SIZE), 0) > 0
    np.savez(output, **{"skin": face_of(skin), **maps})  # type: ignore[arg-type]
    engines = sorted(set(made.engines.values())) if made is not None else []
    return Made(end - begin, {**avatar.timings_s, WRITING: end - writing}, peak, megabytes, ", ".join(engines))


def face_of(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The part of a map of the whole chart (H, W, ...) that is compared."""
    height, width = values.shape[:2]
    top, bottom, left, right = SHOWN
    return values[round(top * height) : round(bottom * height), round(left * width) : round(right * width)]


def isolated(work: Callable[..., T], *arguments: Any) -> T:
    """``work(*arguments)`` in a separate process.

    Args:
        work: a function at the top level of a module.
        arguments: of ``work``, picklable.

    Raises:
        Crashed: the process ended without a result, for example for want of memory.
        Exception: as ``work`` raises it.
    """
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        try:
            return pool.submit(work, *arguments).result()
        except BrokenProcessPool as error:
            raise Crashed(
                f"the process of {work.__name__} ended without a result; there may be too little memory"
            ) from error


def run_bench(
    chosen: Sequence[Run],
    *,
    photo: bytes | None = None,
    launch: Launch = isolated,
    progress: Progress = lambda what, done: None,
) -> Bench:
    """Make every avatar, one after the other.

    Args:
        chosen: what is made; the last is the reference.
        photo: contents of a photo; None for the sample.
        launch: runs a function in a separate process.
        progress: called with the current run and the completed share.

    Raises:
        AvatarError: the reference cannot be made; other faults stand in their rows.
    """
    begin = time.perf_counter()
    data = diagnosis.SAMPLE.read_bytes() if photo is None else photo
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as scratch:
        files = [Path(scratch) / f"{index}.npz" for index in range(len(chosen))]
        for index, (run, file) in enumerate(zip(chosen, files, strict=True)):
            progress(run.label, index / len(chosen))
            try:
                rows.append(Row(run, launch(make, run, data, file)))
            except AvatarError as fault:
                if index == len(chosen) - 1:
                    raise
                rows.append(Row(run, fault=fault.message))
        with np.load(files[-1]) as best:
            rows = [replace(row, losses=_losses(file, best)) for row, file in zip(rows, files, strict=True)]
    costs = [[row.made.seconds if row.made else float("nan"), *(row.losses or {}).values()] for row in rows]
    width = max(map(len, costs))
    front = pareto([cost + [float("nan")] * (width - len(cost)) for cost in costs])
    return Bench(
        machine={
            "processor": diagnosis.cpu(),
            "memory_mb": diagnosis.memory_mb()["total"],
            "platform": platform.platform(),
            "python": platform.python_version(),
            "runtimes": diagnosis.runtimes(),
            "threads": choose_engine().threads,
        },
        rows=[replace(row, front=there) for row, there in zip(rows, front, strict=True)],
        line=line(*zip(*sized(rows), strict=True)) if sized(rows) else None,
        seconds=time.perf_counter() - begin,
    )


def _losses(file: Path, best: Mapping[str, npt.NDArray[Any]]) -> dict[str, float] | None:
    import cv2

    if not file.exists():
        return None
    found = {}
    with np.load(file) as maps:
        for name in COMPARED:
            if name in maps and name in best:
                size = best[name].shape[1::-1]
                skin = cv2.resize(best["skin"].astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
                found[name] = loss_of(COMPARED[name], maps[name], best[name], skin)
    return found


def sized(rows: Sequence[Row]) -> list[tuple[float, float]]:
    """(megatexels, seconds without super-resolution) of the runs whose size was asked for, and of ``standard``."""
    found = []
    for row in rows:
        if row.made is not None and (row.run.options.size or row.run.label == "standard"):
            width, height = row.run.options.map_size
            seconds = row.made.seconds - row.made.timings_s.get("super_resolution", 0.0)
            found.append((width * height / 1e6, seconds))
    return sorted(found)
