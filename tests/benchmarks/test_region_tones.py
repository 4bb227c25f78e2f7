"""The table of regions over cheeks, on values that are known."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")

from benchmarks.region_tones import REGIONS, table


def test_means_are_of_logarithms_and_what_is_not_shown_is_left_out() -> None:
    """A skin whose neck no photo shows would make the mean of all necks nothing."""
    real = {"a": dict.fromkeys(REGIONS, 0.5), "b": dict.fromkeys(REGIONS, 2.0) | {"neck": float("nan")}}
    trained: list[dict[str, float]] = [dict.fromkeys(REGIONS, float(np.exp(0.3))), {}]
    lines = table(real, trained)
    assert len(lines) == len(REGIONS) + 1, "a head, a rule, and every region but the cheeks"
    assert "| lids | 0.50 | 2.00 | 0.00 | 0.69 | 0.30 | 0.00 |" in lines
    assert "| neck | 0.50 | - | -0.69 | 0.00 | 0.30 | 0.00 |" in lines
    assert table({"a": {}}, [])[-1] == "| neck | - | - | - | - | - |"
