"""A picture of an archive against an independent renderer, small; the benchmark has the full size."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
pytest.importorskip("mitsuba", reason="mitsuba is not installed: pip install '.[dev]'")

from service.archive.pack import write_archive
from service.diagnosis import SAMPLE
from service.options import Options
from service.pipeline import make_avatar

pytestmark = [pytest.mark.train, pytest.mark.slow]


def test_a_picture_is_lit_as_mitsuba_lights_it(tmp_path: Path) -> None:
    from benchmarks.render_against_mitsuba import compare

    archive = tmp_path / "sample.zip"
    write_archive(make_avatar(SAMPLE.read_bytes(), Options(quality="draft", size=(768, 512))), archive)
    results = compare(archive, 64, 48)
    assert set(results) == {"lamp", "environment"}
    for name, found in results.items():
        assert found.pixels > 500
        assert found.mean <= 5.0, name
