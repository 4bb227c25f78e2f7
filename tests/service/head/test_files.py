"""Head model files: what goes in comes out, and nothing damaged gets through.

Height of an opening: the lowest row of the upper edge over the highest of the lower one.
"""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from models.head.writing import save_head
from service.errors import ModelFault
from service.head.files import load_head, split_polygons
from service.head.model import HeadModel
from service.head.regions import OpeningEdges, lid_edges
from tests.toyhead import sphere_head


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return sphere_head(12, 24)


def test_round_trip_keeps_every_field(head: HeadModel, tmp_path: Path) -> None:
    save_head(head, tmp_path / "head.npz")
    back = load_head(tmp_path / "head.npz")
    for field in dataclasses.fields(HeadModel):
        before, after = getattr(head, field.name), getattr(back, field.name)
        if isinstance(before, np.ndarray):
            assert after.dtype == before.dtype
            half = field.name in ("identity", "expression", "regions")
            np.testing.assert_allclose(after, before, atol=1e-3 * np.abs(before).max(initial=0) if half else 0)
        else:
            assert after == before


def test_shipped_head_loads_fast() -> None:
    load_head()
    start = time.process_time()
    load_head()
    assert time.process_time() - start < 0.15


@pytest.mark.parametrize("keep", [0, 10, 400, 5000, -1])
def test_cut_file_is_refused(head: HeadModel, tmp_path: Path, keep: int) -> None:
    save_head(head, tmp_path / "head.npz")
    data = (tmp_path / "head.npz").read_bytes()
    (tmp_path / "head.npz").write_bytes(data[:keep])
    with pytest.raises(ModelFault):
        load_head(tmp_path / "head.npz")


def test_flipped_bits_are_refused(head: HeadModel, tmp_path: Path) -> None:
    save_head(head, tmp_path / "head.npz")
    data = bytearray((tmp_path / "head.npz").read_bytes())
    data[len(data) // 2] ^= 0x40
    (tmp_path / "head.npz").write_bytes(data)
    with pytest.raises(ModelFault, match="cannot be read"):
        load_head(tmp_path / "head.npz")


def _changed(head: HeadModel, **changes: Any) -> HeadModel:
    return dataclasses.replace(head, **changes)


def test_faults_are_named(head: HeadModel, tmp_path: Path) -> None:
    """Each of these would otherwise surface as a crash or a NaN somewhere in the fit."""
    broken_mean = head.mean.copy()
    broken_mean[3, 1] = np.nan
    far = head.polygons.copy()
    far[0, 0] = len(head.mean)
    one_way = head.mirror.copy()
    one_way[0], one_way[1] = 1, 2
    outside = head.uv.copy()
    outside[0, 0] = 1.5
    weights = head.landmark_barycentric * np.float32(1.1)
    cases: list[tuple[HeadModel, str]] = [
        (_changed(head, mean=broken_mean), "mean holds values that are not finite"),
        (_changed(head, polygons=far), "polygons points to"),
        (_changed(head, mirror=one_way), "mirror is not its own inverse"),
        (_changed(head, uv=outside), "uv leaves"),
        (_changed(head, landmark_barycentric=weights), "does not sum to 1"),
        (_changed(head, identity=head.identity[:, :-1]), "axis V should be"),
        (_changed(head, regions=head.regions[:-1]), "axis R should be"),
        (_changed(head, expression_names=(head.expression_names[0],) * len(head.expression_names)), "not unique"),
        (_changed(head, part_names=("face", *head.part_names[1:])), "first part must be 'skin'"),
    ]
    for model, message in cases:
        with pytest.raises(ModelFault, match=message):
            save_head(model, tmp_path / "head.npz")


def test_triangles_follow_polygons() -> None:
    polygons = np.array([[0, 1, 2, 3], [3, 2, 4, -1]], np.int32)
    np.testing.assert_array_equal(split_polygons(polygons), [[0, 1, 2], [3, 2, 4], [0, 2, 3]])


def test_pickle_is_never_opened(tmp_path: Path) -> None:
    np.savez(tmp_path / "evil.npz", header=np.array([{"a": 1}], dtype=object))
    with pytest.raises(ModelFault, match="cannot be read"):
        load_head(tmp_path / "evil.npz")


def test_the_rows_that_bound_it_count() -> None:
    """A lid is thick: measured at its front row alone, shut eyes stood open by millimetres."""
    x = np.array([-1.0, 0.0, 2.0])
    rows = [np.stack([x, np.full(3, y), np.zeros(3)], 1) for y in (3.0, 2.0, -1.0, 0.5)]
    edges = OpeningEdges((np.arange(3), np.arange(3, 6)), (np.arange(6, 9), np.arange(9, 12)))
    vertices = np.concatenate(rows)
    assert edges.height(vertices) == pytest.approx(1.5)
    vertices[3:6, 1] = 0.0
    assert edges.height(vertices) == pytest.approx(-0.5), "overlapping edges have a negative height"


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_blink_closes_the_head_in_the_box(side: str) -> None:
    head = load_head()
    edges = lid_edges(head, side)
    assert edges is not None
    blink = head.expression[head.expression_names.index(f"eyeBlink{side.capitalize()}")]
    assert edges.height(head.mean) > 5e-3
    assert edges.height(head.mean + blink) < 0.2e-3
