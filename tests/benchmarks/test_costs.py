"""What the benchmarks of cost print, from numbers that are given."""

from __future__ import annotations

import pytest

pytest.importorskip("torch")

from benchmarks import accuracy_time, runtimes, scaling
from benchmarks.corrections.score import Score


def test_straight_lines_and_growing_memory_are_told() -> None:
    sizes = {width: (2.0 + 3.0 * width * width * 2 / 3e6, 400.0) for width in (768, 1536, 3072)}
    lines = scaling.tables(sizes, [(2.0, 300.0), (1.0, 310.0), (1.0, 310.0), (1.0, 355.0)], 768)
    assert "2.0 s + 3.00 s / Mtexel, off by 0 % at most." in lines
    assert lines[-1].endswith("Memory grew by 45 MiB after photo 3.")
    assert "Too few points for a line." in scaling.tables({768: (1.0, 1.0)}, [(1.0, 1.0)] * 3, 768)


def test_a_wrong_choice_of_the_rule_is_told() -> None:
    seconds = {"PyTorch": 8.0, "onnxruntime fp32": 4.0, "openvino fp32": 2.0}
    rho = runtimes.Timed("rho", seconds, "onnxruntime fp32")
    zeta = runtimes.Timed("zeta_tail", seconds, "openvino fp32")
    lines = runtimes.table([rho, zeta])
    assert "| all | 16.00 (1.00) | 8.00 (2.00) | 4.00 (4.00) |  |" in lines
    assert "auto: 6.00 s, 2.67 times as fast as PyTorch eager" in lines
    assert [line for line in lines if "but" in line] == [
        "rho: auto chose onnxruntime fp32, but openvino fp32 was faster"
    ]


def test_the_front_has_what_nothing_beats_and_missing_figures_are_left_out() -> None:
    poor, good = Score(20.0, 18.0, 6.0, float("nan")), Score(22.0, 19.0, 5.0, 17.0)
    ways = [("draft", 10.0, poor), ("standard", 40.0, good), ("high", 50.0, good)]
    points = [accuracy_time.Point(name, "onnxruntime", seconds, score, 25.0) for name, seconds, score in ways]
    lines = accuracy_time.table(points, poor)
    assert [line.split(" | ")[0].strip("| ") for line in lines if "front" in line] == ["quality", "draft", "standard"]
    both = accuracy_time.mean([poor, good])
    assert (both.best, both.unseen) == (21.0, 17.0)
