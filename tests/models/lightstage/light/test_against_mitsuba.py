"""The light against an independent renderer, small; ``benchmarks.light_against_mitsuba`` has the full size."""

from __future__ import annotations

import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
pytest.importorskip("mitsuba", reason="mitsuba is not installed: pip install '.[dev]'")

from benchmarks.light_against_mitsuba import compare

pytestmark = [pytest.mark.train, pytest.mark.slow]


def test_face_is_lit_as_mitsuba_lights_it() -> None:
    results = compare(64, 96, "apartment")
    assert set(results) == {"environment", "3 lamps", "both"}
    for name, result in results.items():
        assert result.pixels > 500
        assert result.mean <= 3.0, name
