from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")

from benchmarks.calibration import DISTANCES_MM, RANGES_MM, Errors, correlation, errors, report, table
from models.people.make import Portrait
from service.face.reading.parts import PARTS, SKIN
from service.face.reading.reader import CELLS, PART_CELLS, Reading
from service.face.region import Region
from service.geometry.camera import Camera


def face(count: int, sigma: float, seed: int, common: float = 0.0) -> Errors:
    """Errors of the deviation that is stated, a share of whose variance is the same for the whole face."""
    random = np.random.default_rng(seed)
    own, shared = random.normal(0, sigma, (count, 2)), random.normal(0, sigma, 2)
    off = np.sqrt(1 - common) * own + np.sqrt(common) * shared
    turn = np.linalg.norm(random.normal(0, 0.1, (count, 3)), axis=1)
    return Errors(random.uniform(0, 80, (count, 2)), off, np.full(count, sigma), turn, np.full(count, 0.1))


def cells(row: str) -> list[str]:
    return [cell.strip() for cell in row.strip("|").split("|")]


def test_a_reader_that_knows_itself_has_the_shares_of_a_gaussian() -> None:
    one = face(40_000, 2.5, 0)
    row = cells(table("mm", np.linalg.norm(one.off, axis=1) / one.sigma_mm, one.sigma_mm, RANGES_MM, 2)[2])
    assert abs(float(row[2]) - 0.39) < 0.015 and abs(float(row[3]) - 1.18) < 0.02
    row = cells(table("sine", one.turn / one.sine, one.sine, (0.0, 1.0), 3)[2])
    assert abs(float(row[2]) - 0.20) < 0.015 and abs(float(row[3]) - 1.54) < 0.02


def test_one_that_is_too_sure_is_found_out() -> None:
    one = face(5_000, 2.5, 0)
    row = cells(table("mm", np.linalg.norm(one.off, axis=1) / 1.2, np.full(5_000, 1.2), RANGES_MM, 2)[2])
    assert float(row[2]) < 0.15 and float(row[3]) > 2.0


def test_errors_that_all_cells_share_are_correlated_at_every_distance() -> None:
    alone = [value for _, value in correlation([face(2_000, 2.0, seed) for seed in range(6)])]
    shared = [value for _, value in correlation([face(2_000, 2.0, seed, 0.6) for seed in range(40)])]
    assert np.abs(alone).max() < 0.05
    assert min(shared) > 0.35


def test_no_error_and_a_single_cell_are_no_division_by_zero() -> None:
    exact = face(100, 1.0, 0)
    exact = Errors(exact.place, np.zeros((100, 2)), exact.sigma_mm, np.zeros(100), exact.sine)
    assert len(correlation([exact, face(1, 1.0, 1)])) == len(DISTANCES_MM) - 1
    assert report([exact])[0].startswith("1 people, 100 cells: chart 0.00 mm, normals 0.0 degrees")


def test_only_cells_on_known_skin_inside_the_portrait_count() -> None:
    """A portrait of which the left half is skin, read in a crop that reaches beyond its right and lower edges."""
    chart = np.full((64, 64, 2), np.nan, np.float32)
    chart[:, :32] = 0.5
    part = np.where(np.isfinite(chart[..., 0]), SKIN, 0).astype(np.uint8)
    normal = np.tile(np.array([0.0, 0.0, -1.0], np.float32), (64, 64, 1))
    camera = Camera(64, 64, 1e6, np.array([32.0, 32.0]), np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]))
    empty = np.zeros((0, 2), np.float32)
    person = Portrait(
        0, np.zeros((64, 64, 3), np.uint8), b"", chart, normal, np.ones((64, 64), np.float32), part, empty,
        np.zeros(0, bool), camera, empty, empty, empty, "open", np.zeros(2, np.float32),
    )  # fmt: skip
    shares = np.zeros((PART_CELLS, PART_CELLS, len(PARTS)), np.float32)
    shares[: PART_CELLS // 2, :, SKIN] = 1.0
    reading = Reading(
        Region(64.0, 64.0, 128.0), np.full((CELLS, CELLS, 2), 0.5), np.ones((CELLS, CELLS)),
        np.tile([0.0, 0.0, -1.0], (CELLS, CELLS, 1)), np.full((CELLS, CELLS), 0.1), shares,
    )  # fmt: skip
    found = errors(reading, person)
    assert len(found.off) == (CELLS // 2) * (CELLS // 4)
    assert np.abs(found.off).max() < 1e-6 and found.turn.max() < 1e-3
