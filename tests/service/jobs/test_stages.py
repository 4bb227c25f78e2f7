"""Finished stages of a job on the disk, in memory or mapped."""

from __future__ import annotations

import io
import zipfile
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, get_args, get_type_hints

import cv2
import numpy as np
import pytest

from service.jobs.artifacts import Artifacts
from service.jobs.child import kinds
from service.jobs.stages import KeptStages

JOB = "a" * 32


@pytest.fixture(params=["file", "memory"])
def artifacts(request: pytest.FixtureRequest, tmp_path: Path) -> Artifacts:
    """On a disk, and in a store that is none."""
    root = f"file://{tmp_path}/store" if request.param == "file" else f"memory://stages-{tmp_path.name}"
    made = Artifacts(root)
    made._fs.makedirs(f"{made._root}/{JOB}", exist_ok=True)
    return made


@pytest.mark.parametrize("mapped", [False, True])
def test_a_stage_is_computed_once(artifacts: Artifacts, tmp_path: Path, mapped: bool) -> None:
    told: list[str] = []
    value = np.arange(600, dtype=np.int16).reshape(20, 30)
    stages = KeptStages(artifacts, JOB, "basis", {}, tmp_path, told.append, mapped=mapped)
    first = stages.keep("one", lambda: value)
    again: Any = stages.keep("one", lambda: pytest.fail("it was computed again"))
    for found in (first, again):
        assert np.array_equal(found, value)
        assert found.dtype == value.dtype
    assert first.flags.writeable != mapped, "only what is mapped stays in its file"
    assert again.flags.writeable != mapped
    assert told == ["one"]


def test_a_stage_that_cannot_be_mapped_goes_on_in_memory(
    artifacts: Artifacts, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full: less memory was a wish, the result is not."""

    def fail(*a: Any, **b: Any) -> None:
        raise OSError(28, "full")

    stages = KeptStages(artifacts, JOB, "basis", {}, tmp_path, mapped=True)
    monkeypatch.setattr(artifacts, "put", fail)
    assert np.array_equal(stages.keep("one", lambda: np.ones(3)), np.ones(3))


@pytest.mark.slow
def test_a_job_that_gets_by_with_less_memory_makes_the_same_maps_and_says_so(tmp_path: Path) -> None:
    """The pipeline with small tiles and mapped stages, against itself without. No stage may write into what it gets."""
    from service.archive.manifest import from_json
    from service.archive.pack import write_archive
    from service.diagnosis import SAMPLE
    from service.jobs.child import options_from
    from service.pipeline import SMALL_TILES, make_avatar
    from service.runtime.tiles import DEFAULT_TILE, SMALL_TILE
    from service.stages import Stages, Unkept

    stages: Stages = KeptStages(Artifacts(f"file://{tmp_path}/store"), JOB, "basis", kinds(), tmp_path, mapped=True)
    options = options_from({"quality": "draft", "size": [576, 384]})
    found = []
    for kept, tile in ((stages, SMALL_TILE), (Unkept(), DEFAULT_TILE)):
        stream = io.BytesIO()
        write_archive(make_avatar(SAMPLE.read_bytes(), options, stages=kept, tile=tile), stream)
        found.append(zipfile.ZipFile(stream))
    tight, usual = (from_json(archive.read("manifest.json")) for archive in found)
    assert SMALL_TILES in tight.warnings
    assert SMALL_TILES not in usual.warnings
    assert tight.reflectance is not None
    assert tight.reflectance.tile == SMALL_TILE
    for map_ in usual.maps:
        one, other = (cv2.imdecode(np.frombuffer(archive.read(map_.path), np.uint8), -1) for archive in found)
        assert one is not None
        assert other is not None
        apart = np.abs(one.astype(int) - other.astype(int))
        assert apart.max() <= (1 if map_.bits == 8 else 8), map_.path
        assert (apart > 0).mean() < 0.01, map_.path


def test_whatever_a_kept_result_holds_is_known_too() -> None:
    known = kinds()
    for kind in known.values():
        for field, hint in get_type_hints(kind).items():
            for part in (hint, *get_args(hint)):
                if is_dataclass(part) and isinstance(part, type):
                    assert part.__name__ in known, f"{kind.__name__}.{field} is a {part.__name__}, which is not kept"
