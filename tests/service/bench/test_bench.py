"""The benchmark's measures against closed forms, and the benchmark itself on small avatars of the sample."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from service import diagnosis
from service.bench.report import MARK, as_markdown, draw, put
from service.bench.runs import (
    COMPARED,
    SAME_DB,
    Row,
    decibels,
    degrees,
    face_of,
    isolated,
    line,
    loss_of,
    make,
    pareto,
    run_bench,
    runs,
)
from service.cli.bench_and_doctor import bench as command
from service.errors import Crashed, ModelFault, UsageError
from service.levels import LEVELS
from service.options import Options
from service.reflectance.translate import pack_normals

EVERYTHING = np.ones((8, 8), bool)


def test_pareto_front() -> None:
    points = [(1, 5), (2, 3), (2, 4), (3, 3), (4, 1), (4, 1), (float("nan"), 0)]
    assert pareto(points) == [True, True, False, False, True, True, False]
    assert pareto([]) == []
    assert pareto([(1, 2, 9), (1, 2, 8)]) == [False, True]


def test_a_straight_line_is_found_and_a_bent_one_told() -> None:
    x = [0.4, 1.6, 6.3, 25.2]
    straight, bent = (line(x, [3 + 2 * value**power for value in x]) for power in (1, 1.5))
    assert straight is not None and bent is not None
    assert [straight.start, straight.slope] == pytest.approx([3, 2])
    assert straight.worst < 1e-9 and bent.worst > 0.1


@pytest.mark.parametrize(("x", "y"), [([1, 2], [1, 2]), ([1, 2, 3], [1, 0, 1]), ([2, 2, 2], [1, 2, 3])])
def test_no_line_where_none_says_anything(x: list[float], y: list[float]) -> None:
    """Two points are always on one; a time of nothing cannot be weighed; one size has no slope."""
    assert line(x, y) is None


def test_psnr_of_a_constant_difference() -> None:
    a = np.full((8, 8, 3), 10000, np.uint16)
    assert loss_of("colour", a + np.uint16(6553), a, EVERYTHING) == pytest.approx(6553 / 65535, rel=1e-5)
    assert decibels(0.1) == pytest.approx(20)
    assert decibels(0) == SAME_DB


def test_angle_of_a_known_turn() -> None:
    flat, tilted = (pack_normals(*np.full((3, 8, 8), np.array(v)[:, None, None])) for v in ((0, 0, 1), (0.5, 0, 1)))
    assert loss_of("normal", tilted, flat, EVERYTHING) == pytest.approx(np.degrees(np.arctan(0.5)), abs=0.01)
    small = degrees(np.array([0, 0, 1.0], np.float32), np.array([1e-4, 0, 1.0], np.float32))
    assert small == pytest.approx(np.degrees(1e-4), rel=1e-4), "a cosine would have lost it"
    assert degrees(np.zeros(3, np.float32), np.array([0, 0, 1], np.float32)) == 0


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


def test_a_file_keeps_the_text_around_its_table() -> None:
    text = put("# Title\n\nWords.\n", "one\n")
    assert text == f"# Title\n\nWords.\n\n{MARK[0]}\none\n{MARK[1]}\n"
    assert put(text + "\nAfter.\n", "two\n") == text.replace("one", "two") + "\nAfter.\n"


def test_memory_is_that_of_the_measured_process_alone() -> None:
    held = np.ones(50_000_000)
    assert isolated(diagnosis.peak_rss_mb) < 0.8 * diagnosis.peak_rss_mb()
    assert held[0] == 1


def leave() -> None:
    os._exit(9)


def test_a_process_that_dies_is_a_fault_not_a_hang() -> None:
    with pytest.raises(Crashed, match="leave"):
        isolated(leave)


def test_the_table_of_real_avatars(tmp_path: Path) -> None:
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
    draw(found, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 10_000


def test_without_a_reference_there_is_no_table() -> None:
    def fails(*_: object) -> None:
        raise ModelFault("no networks")

    with pytest.raises(ModelFault):
        run_bench(runs(quick=True), photo=b"", launch=fails)


def test_the_face_is_in_the_middle_of_the_chart() -> None:
    assert face_of(np.zeros((4096, 6144))).shape == (1536, 1536)
    assert face_of(np.zeros((64, 96, 3))).shape == (24, 24, 3)


def test_the_plot_needs_matplotlib(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(UsageError, match="pip install matplotlib"):
        command(quick=True, as_json=False, output=str(tmp_path))
