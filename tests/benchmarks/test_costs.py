"""What the benchmarks of cost print, from numbers that are given."""

from __future__ import annotations

import pytest

pytest.importorskip("torch")

from benchmarks import runtimes


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
