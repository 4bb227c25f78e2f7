"""Our light and our pictures against an independent renderer, small; the tool has the full size."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("mitsuba", reason="mitsuba is not installed: pip install '.[dev]'")

from service.archive.pack import write_archive
from service.diagnosis import SAMPLE
from service.options import Options
from service.pipeline import make_avatar
from tests.tools.against_mitsuba import compare_archive, compare_light

pytestmark = pytest.mark.slow


def test_a_picture_is_lit_as_mitsuba_lights_it(tmp_path: Path) -> None:
    archive = tmp_path / "sample.zip"
    write_archive(make_avatar(SAMPLE.read_bytes(), Options(quality="draft", size=(768, 512))), archive)
    results = compare_archive(archive, 64, 48)
    assert set(results) == {"lamp", "environment"}
    for name, found in results.items():
        assert found.pixels > 500
        assert found.mean <= 5.0, name


@pytest.mark.train
def test_face_is_lit_as_mitsuba_lights_it() -> None:
    pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
    results = compare_light(64, 96, "apartment")
    assert set(results) == {"environment", "3 lamps", "both"}
    for name, found in results.items():
        assert found.pixels > 500
        assert found.mean <= 3.0, name
