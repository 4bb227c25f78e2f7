"""What the benchmarks of cost print, from numbers that are given."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")

from benchmarks import cliffs, runtimes, scaling


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


def test_the_closed_form_of_the_cliff() -> None:
    """Its slopes are the differences of its height but for the tear itself."""
    height, right, down, distance = cliffs.torn(0.6, 0.0)
    middle = (right[:, 1:] + right[:, :-1]) / 2
    whole = (distance > cliffs.MM)[:, 1:] & (distance > cliffs.MM)[:, :-1]
    assert np.abs(np.diff(height, axis=1) - middle)[whole].max() < 2e-3
    assert np.abs(np.diff(height, axis=0) - (down[1:] + down[:-1]) / 2).max() < 2e-3
    assert np.abs(np.diff(height, axis=1) - middle)[~whole].max() > 0.5


def test_without_a_cliff_the_bilateral_reference_is_least_squares() -> None:
    from service.reflectance.relief.integrate import integrate

    _, right, down, _ = cliffs.torn(0.0, 0.0)
    found = cliffs.bilateral(right, down, 2.0)
    plain = integrate(
        right.astype(np.float32), down.astype(np.float32), np.ones(right.shape, bool), tolerance=1e-6, most_steps=99
    ).height
    assert np.abs((found - found.mean()) - plain).max() < 1e-3
