"""The pieces of a map whose detail of gloss is measured."""

from __future__ import annotations

from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest

pytest.importorskip("torch", reason="the light stage knows where cheeks lie")

from benchmarks.gloss_detail import SIDE, main, patches
from models.lightstage.stage import Stage
from service.errors import BadArchive
from service.geometry.chart import Chart

pytestmark = pytest.mark.train


def test_pieces_are_of_both_sides_and_lie_on_the_face() -> None:
    """A mirrored window that is off by its width would measure the ear."""
    stage = Stage.open()
    chart = Chart.build(stage.head, 768, 512)
    face = chart.interpolate(stage.head.region("face")[:, None])[..., 0]
    on_face = np.kron(face * chart.mask, np.ones((8, 8))).astype(np.float64)
    pieces = patches(on_face, stage)
    assert [piece.shape for piece in pieces] == [(SIDE, SIDE)] * 4
    assert all(piece.mean() > 0.9 for piece in pieces)
    sides = patches(np.broadcast_to(np.linspace(0.0, 1.0, 6144), (4096, 6144)), stage)
    for one, other in ((sides[0], sides[1]), (sides[2], sides[3])):
        assert np.allclose(one + other, 1.0)  # each at the mirrored place, its columns mirrored as well


def test_an_archive_without_the_map_is_named(tmp_path: Path) -> None:
    for path in (tmp_path / "none.zip", tmp_path / "empty.zip"):
        if path.stem == "empty":
            ZipFile(path, "w").close()
        with pytest.raises(BadArchive, match=path.name):
            main([path])
