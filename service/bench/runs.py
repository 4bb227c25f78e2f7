"""The benchmark: an avatar of the sample photo at every quality, on every runtime and at several sizes, in one run.

Absolute times differ between machines and over time; ratios hold, as everything is measured in the same run. Every
avatar is made as ``avatarme make`` makes it, in a process of its own, so that caches are cold and memory is its own.
"""

from __future__ import annotations

import os
import platform
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt

from service import diagnosis
from service.arrays import Bool, Float32, Float64
from service.errors import AvatarError, Crashed
from service.levels import FULL_SIZE, LEVELS
from service.options import Options
from service.reflectance.reflectance_maps import unpack_normals
from service.runtime.networks import choose_engine
from service.runtime.sessions import has_openvino

if TYPE_CHECKING:
    from service.archive.avatar import Avatar

T = TypeVar("T")
Kind = Literal["colour", "normal"]

COMPARED: dict[str, Kind] = {
    "diffuse_albedo": "colour", "specular_albedo": "colour", "specular_normal": "normal", "diffuse_normal": "normal",
}  # fmt: skip
"""Maps whose loss is told."""

SHOWN = (5 / 16, 11 / 16, 3 / 8, 5 / 8)
"""The part of the chart on which maps are compared, where the face is: first and last row, first and last column."""

SIZES = (1536, 3072, 6144)
QUICK_SIZES = (384, 768, 1536)
"""Widths of maps; through their times the line is drawn."""

SAME_DB = 99.0
"""PSNR reported for identical maps."""


@dataclass(frozen=True)
class Row:
    """One run.

    Attributes:
        label: in words.
        options: what was asked of ``make_avatar``.
        fault: why there is no avatar; "" where there is one, and only then the rest holds.
        seconds: from the photo's bytes to the archive on the disk.
        processor_s: processor seconds of the same.
        timings_s: by stage, with "write".
        peak_mb: largest resident memory of the process, MiB.
        megabytes: of the archive.
        engines: runtime and precision of the networks, in words.
        losses: by map against the last run: root mean square of coded colours in [0, 1], or mean degrees of normals.
        truth: decibels against what was rendered, by what was judged; empty where the truth is not known.
        front: whether no other run takes less of the processor and is better.
    """

    label: str
    options: Options
    fault: str = ""
    seconds: float = float("nan")
    processor_s: float = float("nan")
    timings_s: Mapping[str, float] = field(default_factory=dict)
    peak_mb: float = 0.0
    megabytes: float = 0.0
    engines: str = ""
    losses: Mapping[str, float] = field(default_factory=dict)
    truth: Mapping[str, float] = field(default_factory=dict)
    front: bool = False

    @property
    def badness(self) -> list[float]:
        """What counts beside processor seconds, smaller is better: decibels to a known truth, else losses."""
        return [-value for value in self.truth.values()] or list(self.losses.values())


@dataclass(frozen=True)
class FittedLine:
    """Least-squares line ``start + slope x``, and the largest relative deviation of a point from it."""

    start: float
    slope: float
    worst: float


@dataclass(frozen=True)
class Bench:
    """All results: facts of the machine, the rows, seconds without super-resolution against megatexels, duration."""

    machine: Mapping[str, Any]
    rows: Sequence[Row]
    line: FittedLine | None
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """JSON values."""
        rows = []
        for row in self.rows:
            facts = asdict(row) | {"options": row.options.to_json()}
            names = ("seconds", "processor_s", "timings_s", "peak_mb", "megabytes", "engines")
            made = {name: facts.pop(name) for name in names}
            loss = {name: shown_loss(name, value) for name, value in facts.pop("losses").items()}
            rows.append({**facts, "made": None if row.fault else made, "loss": loss})
        fitted = None if self.line is None else asdict(self.line)
        return {"machine": dict(self.machine), "runs": rows, "line": fitted, "seconds": self.seconds}


def shown_loss(name: str, loss: float) -> float:
    """PSNR of a colour in decibels, at most ``SAME_DB``, degrees of a normal."""
    return loss if COMPARED[name] == "normal" else min(-20 * float(np.log10(max(loss, 1e-12))), SAME_DB)


def runs(*, quick: bool) -> list[Row]:
    """What is to be made, the reference last. Qualities that are the same on this machine are still made each."""
    plain = Options(quality="draft", face="largest")

    def sized(options: Options, width: int) -> Row:
        size = (width, width * FULL_SIZE[1] // FULL_SIZE[0])
        return Row(f"{options.quality}, {width} wide", replace(options, size=size))

    if quick:
        return [sized(plain, width) for width in QUICK_SIZES]
    found = [Row("draft, onnxruntime", replace(plain, runtime="onnxruntime"))] if has_openvino() else []
    found += [sized(replace(plain, quality="standard"), width) for width in SIZES[:-1]]
    qualities: dict[str, Any] = {name: name for name in LEVELS}
    return found + [Row(name, replace(plain, quality=quality)) for name, quality in qualities.items()]


def make(
    run: Row, photo: bytes | Sequence[bytes], output: Path | None,
    judge: Callable[[Avatar], Mapping[str, float]] = lambda avatar: {},
) -> Row:  # fmt: skip
    """Make an avatar and its archive, and write the face of its maps and the mask of skin; raises as ``make_avatar``.

    ``photo`` are its bytes, or those of several. ``output`` is an ``.npz`` file for the maps; None: they are not
    compared. ``judge`` tells decibels against the truth.
    """
    begin, used = time.perf_counter(), processor_seconds()
    from service.archive.pack import write_archive
    from service.pipeline import make_avatar
    from service.reflectance.subject import GEOMETRY_SIZE, Subject

    avatar = make_avatar(photo, run.options)
    writing = time.perf_counter()
    with tempfile.TemporaryDirectory() as scratch:
        target = Path(scratch) / "avatar.zip"
        write_archive(avatar, target)
        megabytes = target.stat().st_size / 1e6
    end, spent = time.perf_counter(), processor_seconds() - used
    peak, made = diagnosis.peak_rss_mb(), avatar.reflectance
    found = replace(
        run, seconds=end - begin, processor_s=spent, timings_s={**avatar.timings_s, "write": end - writing},
        peak_mb=peak, megabytes=megabytes, truth=judge(avatar),
        engines=", ".join(sorted(set(made.engines.values())) if made is not None else []),
    )  # fmt: skip
    if output is None:
        return found
    maps = {name: face_of(codes) for name in COMPARED if (codes := getattr(made, name, None)) is not None}
    subject = Subject.fitted(avatar.head, avatar.fit).wearing(avatar.texture)
    skin = np.where(subject.chart.mask, subject.skin(GEOMETRY_SIZE), 0) > 0
    np.savez(output, **{"skin": face_of(skin), **maps})  # type: ignore[arg-type]
    return found


def processor_seconds() -> float:
    """Processor seconds of this process and of those that it started and that have ended."""
    return sum(os.times()[:4])


def face_of(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The part of a map of the whole chart (H, W, ...) that is compared."""
    height, width = values.shape[:2]
    top, bottom, left, right = SHOWN
    return values[round(top * height) : round(bottom * height), round(left * width) : round(right * width)]


def isolated(work: Callable[..., T], *arguments: Any) -> T:
    """``work(*arguments)``, a function at the top level of a module, in a process of its own.

    Crashed: the process ended without a result, for example for want of memory. What ``work`` raises is raised here.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line has it
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        try:
            return pool.submit(work, *arguments).result()
        except BrokenProcessPool as error:
            words = f"the process of {getattr(work, '__name__', 'a run')} ended without a result; there may be too "
            raise Crashed(f"{words}little memory") from error


def run_bench(
    chosen: Sequence[Row],
    *,
    photo: bytes | None = None,
    launch: Callable[..., Any] = isolated,
    making: Callable[[Row, bytes, Path], Row] = make,
    progress: Callable[[str, float], None] = lambda what, done: None,
) -> Bench:
    """Make every avatar, one after the other; the last is the reference.

    ``photo`` are the contents of a photo, None for the sample; ``launch`` runs a function in a separate process, and
    ``making`` is :func:`make`, or what judges its avatars, too. AvatarError: the reference cannot be made; other faults
    stand in their rows.
    """
    begin = time.perf_counter()
    data = diagnosis.SAMPLE.read_bytes() if photo is None else photo
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as scratch:
        files = [Path(scratch) / f"{index}.npz" for index in range(len(chosen))]
        for index, (run, file) in enumerate(zip(chosen, files, strict=True)):
            progress(run.label, index / len(chosen))
            try:
                rows.append(launch(making, run, data, file))
            except AvatarError as fault:
                if index == len(chosen) - 1:
                    raise
                rows.append(replace(run, fault=fault.message))
        with np.load(files[-1]) as best:
            rows = [replace(row, losses=_losses(file, best)) for row, file in zip(rows, files, strict=True)]
    costs = [[row.processor_s, *row.badness] for row in rows]
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


def sized(rows: Sequence[Row]) -> list[tuple[float, float]]:
    """(megatexels, seconds without super-resolution) of the runs whose size was asked for, and of ``standard``."""
    found = []
    for row in rows:
        if not row.fault and (row.options.size or row.label == "standard"):
            width, height = row.options.map_size
            found.append((width * height / 1e6, row.seconds - row.timings_s.get("super_resolution", 0.0)))
    return sorted(found)


def _losses(file: Path, best: Mapping[str, npt.NDArray[Any]]) -> dict[str, float]:
    import cv2

    found: dict[str, float] = {}
    if not file.exists():
        return found
    with np.load(file) as maps:
        for name in COMPARED:
            if name in maps and name in best:
                size = best[name].shape[1::-1]
                skin = cv2.resize(best["skin"].astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
                found[name] = loss_of(COMPARED[name], maps[name], best[name], skin)
    return found


def loss_of(kind: Kind, found: npt.NDArray[Any], reference: npt.NDArray[Any], mask: Bool) -> float:
    """Distance of a map from a reference of any other size; the smaller one is enlarged, so that lost detail counts.

    Root mean square of coded colours in [0, 1] ("colour": uint16 codes, 65535 = 1), or mean degrees of normals
    ("normal": (h, w, 2) int16 codes). The reference is (H, W, ...) of the same part of the chart; of it the texels of
    the mask (H, W) are compared, all of them where there is none.
    """
    one, other = (_values(kind, codes, reference.shape[1::-1]) for codes in (found, reference))
    chosen = mask if mask.any() else np.ones_like(mask)
    if kind == "normal":
        return float(degrees(one[chosen], other[chosen]).mean())
    return float(np.sqrt(np.square(one[chosen] - other[chosen], dtype=np.float64).mean()))


def degrees(found: Float32, reference: Float32) -> Float64:
    """(...) angles between vectors (..., 3) of any length; 0 where one is zero. Accurate for small angles."""
    one, other = (np.asarray(vectors, np.float64) for vectors in (found, reference))
    sine = np.linalg.norm(np.cross(one, other), axis=-1)
    return np.asarray(np.degrees(np.arctan2(sine, np.einsum("...i,...i->...", one, other))))


def _values(kind: Kind, codes: npt.NDArray[Any], size: tuple[int, int]) -> Float32:
    """Colours in [0, 1] or normals, resampled to (width, height) and not normalised again."""
    import cv2

    # OpenCV drops an axis of length 1; comparing maps with and without it would broadcast.
    plain = codes[..., 0] if codes.ndim == 3 and codes.shape[2] == 1 else codes
    values = unpack_normals(codes) if kind == "normal" else np.asarray(plain, np.float32) / np.float32(65535)
    if values.shape[1::-1] == size:
        return values
    way = cv2.INTER_AREA if size[0] <= values.shape[1] else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(values, size, interpolation=way), np.float32)


def pareto(points: Sequence[Sequence[float]]) -> list[bool]:
    """Whether each point (every coordinate: smaller is better) is on the Pareto front.

    A point is dominated where another is at least as good in every coordinate and better in one. Equal points are all
    on the front. A point with a NaN is never on it.
    """
    table = np.asarray(points, np.float64)
    others = table[~np.isnan(table).any(1)] if len(table) else table
    return [
        bool(not np.isnan(point).any() and not ((others <= point).all(1) & (others < point).any(1)).any())
        for point in table
    ]


def line(x: Sequence[float], y: Sequence[float]) -> FittedLine | None:
    """Least-squares line through points weighted by 1 / y, which minimises relative errors.

    None with fewer than three points, which a line fits exactly, or with a y that is not above 0.
    """
    across, up = np.asarray(x, np.float64), np.asarray(y, np.float64)
    if len(across) < 3 or not (up > 0).all() or np.ptp(across) == 0:
        return None
    slope, start = np.polyfit(across, up, 1, w=1 / up)
    worst = float(np.abs((start + slope * across) / up - 1).max())
    return FittedLine(float(start), float(slope), worst)
