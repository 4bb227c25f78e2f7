"""The benchmark's measures against closed forms, and the benchmark itself on small avatars of the sample."""

from __future__ import annotations

import json
import os
from dataclasses import replace

import numpy as np
import pytest

from service import diagnosis
from service.bench.report import as_markdown
from service.bench.runs import (
    COMPARED,
    Row,
    isolated,
    line,
    loss_of,
    make,
    run_bench,
    runs,
)
from service.errors import Crashed, ModelFault
from service.levels import LEVELS
from service.options import Options

EVERYTHING = np.ones((8, 8), bool)


def test_a_straight_line_is_found_and_a_bent_one_told() -> None:
    x = [0.4, 1.6, 6.3, 25.2]
    straight, bent = (line(x, [3 + 2 * value**power for value in x]) for power in (1, 1.5))
    assert straight is not None and bent is not None
    assert [straight.start, straight.slope] == pytest.approx([3, 2])
    assert straight.worst < 1e-9 and bent.worst > 0.1


def test_only_the_mask_counts_unless_it_is_empty() -> None:
    a, b = np.zeros((8, 8, 1), np.uint16), np.zeros((8, 8, 1), np.uint16)
    b[:, 4:] = 65535
    half = np.zeros((8, 8), bool)
    half[:, :4] = True
    assert loss_of("colour", a, b, half) == 0
    assert loss_of("colour", a, b, half & ~half) == pytest.approx(np.sqrt(0.5))


def test_a_small_map_loses_the_detail_that_it_has_not() -> None:
    """Also with one plane: a map that lost its last axis would be compared texel by texel with all of the other."""
    full = np.arange(64, dtype=np.uint16).reshape(8, 8, 1) * np.uint16(1000)
    flat = np.full((4, 4, 1), 31500, np.uint16)
    assert loss_of("colour", flat, full, EVERYTHING) == pytest.approx(full.std() / 65535, rel=1e-3)


def test_the_reference_is_the_best_and_every_quality_is_run() -> None:
    for quick in (False, True):
        labels = [run.label for run in runs(quick=quick)]
        assert len(set(labels)) == len(labels), "two rows would look the same"
    assert [run.label for run in runs(quick=False)][-len(LEVELS) :] == list(LEVELS)


def test_memory_is_that_of_the_measured_process_alone() -> None:
    held = np.ones(50_000_000)
    assert isolated(diagnosis.peak_rss_mb) < 0.8 * diagnosis.peak_rss_mb()
    assert held[0] == 1


def leave() -> None:
    os._exit(9)


def test_a_process_that_dies_is_a_fault_not_a_hang() -> None:
    with pytest.raises(Crashed, match="leave"):
        isolated(leave)


@pytest.mark.slow
def test_the_table_of_real_avatars() -> None:
    """Three sizes of the sample: less is lost the nearer they come to the largest, and a run that fails is told."""
    options = Options(quality="draft", face="largest", fit="landmarks", hair="none")
    chosen = [Row(f"{width} wide", replace(options, size=(width, width * 2 // 3))) for width in (96, 192, 384)]
    refused = Row("no such face", replace(options, face=7))

    def here(*arguments: object) -> object:
        return make(*arguments[1:])  # type: ignore[arg-type]

    found = run_bench([refused, *chosen], launch=here)
    assert found.rows[0].fault and not found.rows[0].losses
    lost = [dict(row.losses) for row in found.rows[1:]]
    assert all(lost[0][name] > lost[1][name] > lost[2][name] == 0 for name in COMPARED), lost
    assert found.rows[-1].front and found.line is not None
    json.dumps(found.to_json(), allow_nan=False)
    assert "| 384 wide | " in as_markdown(found) and " same | " in as_markdown(found)
    assert [row.processor_s > 0 for row in found.rows] == [False, True, True, True]


def test_without_a_reference_there_is_no_table() -> None:
    def fails(*_: object) -> None:
        raise ModelFault("no networks")

    with pytest.raises(ModelFault):
        run_bench(runs(quick=True), photo=b"", launch=fails)
