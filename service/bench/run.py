"""The benchmark: every variant of every stage and of the whole, one after the other, in one run.

Absolute times differ between machines and over time; ratios hold, as everything is measured in the same run.
"""

from __future__ import annotations

import platform
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

from service import diagnosis
from service.bench.sample_head import SampleHead, from_photo
from service.bench.stages import marked, measure_stages, rule_notes
from service.bench.variants import NETWORKS, STAGES, Bench, BenchExtent, Family, Launch, Progress, Setting, StageName
from service.bench.whole import marked_wholes, measure_wholes, straight
from service.errors import Crashed, ModelFault
from service.runtime.networks import choose_engine, describe_network

T = TypeVar("T")


def isolated(work: Callable[..., T], *arguments: Any) -> T:
    """``work(*arguments)`` in a separate process, so that caches are cold and its peak memory is measured alone.

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
    extent: BenchExtent,
    families: Sequence[Family],
    *,
    photo: bytes | None = None,
    chosen: Sequence[StageName] = STAGES,
    launch: Launch = isolated,
    progress: Progress = lambda what, done: None,
) -> Bench:
    """Measure.

    Args:
        extent: which variants.
        families: of networks; the first is the reference.
        photo: contents of the photo to measure on; None for the sample photo.
        chosen: stages to measure; their inputs from other stages are computed by the reference.
        launch: runs a function in a separate process.
        progress: called with the current measurement and the completed share.

    Raises:
        ModelFault: the first family has none of the networks, or its networks fail.
        AvatarError: as ``service.pipeline.make_avatar``.
    """
    begin = time.perf_counter()
    first = families[0]
    if not set(first.networks) & {name for names in NETWORKS.values() for name in names}:
        raise ModelFault(f"{first.folder} lists no network of maps; name a folder that does with --networks")
    data = diagnosis.SAMPLE.read_bytes() if photo is None else photo
    threads = choose_engine().threads
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        progress("photo", 0.0)
        size = describe_network("zeta_body", first.folder).whole if "zeta_body" in first.networks else None
        launch(from_photo, data, size, extent.side, folder)
        at = Setting(extent, families, folder, launch, data, threads, SampleHead.load(folder))
        rows = measure_stages(at, chosen, progress)
        at.notes.extend(rule_notes(rows, threads, first))
        wholes = measure_wholes(at, progress)
    return Bench(
        machine=_machine(threads, families),
        rows=marked(rows),
        wholes=marked_wholes(wholes),
        line=straight(wholes, extent),
        notes=at.notes,
        seconds=time.perf_counter() - begin,
    )


def _machine(threads: int, families: Sequence[Family]) -> dict[str, Any]:
    return {
        "processor": diagnosis.cpu(),
        "memory_mb": diagnosis.memory_mb()["total"],
        "platform": platform.platform(),
        "python": platform.python_version(),
        "runtimes": diagnosis.runtimes(),
        "threads": threads,
        "families": {family.name: list(family.networks) for family in families},
    }
