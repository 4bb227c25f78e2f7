"""Counters and measures of the benchmark against closed forms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from service.bench.losses import SAME_DB, compare, decibels, degrees, line, pareto
from service.bench.report import MARK, engine_in_words, put
from service.bench.run import isolated
from service.bench.sample_head import Window
from service.bench.stages import coding, computed
from service.bench.variants import CODINGS, FULL, QUICK, STAGES, reference, variants
from service.cli.bench import find_families
from service.diagnosis import peak_rss_mb
from service.errors import Crashed, UsageError
from service.levels import FULL_SIZE
from service.reflectance.translate import pack_normals
from service.runtime.networks import Description, Engine
from tests.service.runtime.toynets import toy_net, write_models

EVERYTHING = np.ones((8, 8), np.uint8)


def test_pareto_front() -> None:
    points = [(1, 5), (2, 3), (2, 4), (3, 3), (4, 1), (4, 1), (float("nan"), 0)]
    assert pareto(points) == [True, True, False, False, True, True, False]
    assert pareto([]) == []
    assert pareto([(1, 2, 9), (1, 2, 8)]) == [False, True]


def test_a_straight_line_is_found_and_a_bent_one_told() -> None:
    x = [0.4, 1.6, 6.3, 25.2]
    straight = line(x, [3 + 2 * value for value in x])
    assert straight is not None
    assert [straight.start, straight.slope] == pytest.approx([3, 2])
    assert straight.worst < 1e-9
    bent = line(x, [3 + 2 * value**1.5 for value in x])
    assert bent is not None
    assert bent.worst > 0.1


@pytest.mark.parametrize(("x", "y"), [([1, 2], [1, 2]), ([1, 2, 3], [1, 0, 1]), ([2, 2, 2], [1, 2, 3])])
def test_no_line_where_none_says_anything(x: list[float], y: list[float]) -> None:
    """Two points are always on one; a time of nothing cannot be weighed; one size has no slope."""
    assert line(x, y) is None


def test_psnr_of_a_constant_difference() -> None:
    a = np.full((8, 8, 3), 10000, np.uint16)
    loss = compare("colour", a + np.uint16(6553), a, EVERYTHING)
    assert loss.at_full == loss.at_own == pytest.approx(6553 / 65535, rel=1e-5)
    assert decibels(0.1) == pytest.approx(20)
    assert decibels(0) == SAME_DB


def test_angle_of_a_known_turn() -> None:
    flat, tilted = (pack_normals(*np.full((3, 8, 8), np.array(v)[:, None, None])) for v in ((0, 0, 1), (0.5, 0, 1)))
    loss = compare("normal", tilted, flat, EVERYTHING)
    assert loss.at_full == pytest.approx(np.degrees(np.arctan(0.5)), abs=0.01)
    small = degrees(np.array([0, 0, 1.0], np.float32), np.array([1e-4, 0, 1.0], np.float32))
    assert small == pytest.approx(np.degrees(1e-4), rel=1e-4), "a cosine would have lost it"
    assert degrees(np.zeros(3, np.float32), np.array([0, 0, 1], np.float32)) == 0


def test_only_the_mask_counts_unless_it_is_empty() -> None:
    a, b = np.zeros((8, 8, 1), np.uint16), np.zeros((8, 8, 1), np.uint16)
    b[:, 4:] = 65535
    half = np.zeros((8, 8), np.uint8)
    half[:, :4] = 1
    assert compare("colour", a, b, half).at_full == 0
    assert compare("colour", a, b, half * 0).at_full == pytest.approx(np.sqrt(0.5))


def test_a_small_map_without_detail_loses_only_at_full_size() -> None:
    rng = np.random.default_rng(0)
    full = rng.integers(0, 65536, (32, 32, 3)).astype(np.uint16)
    small = np.rint(full.reshape(16, 2, 16, 2, 3).mean((1, 3))).astype(np.uint16)
    loss = compare("colour", small, full, np.ones((32, 32), np.uint8))
    assert loss.at_own < 1e-4 < 0.1 < loss.at_full


def test_a_map_with_one_plane_keeps_its_axes_when_it_is_resized() -> None:
    """One that lost its last axis would be compared texel by texel with all texels of the other."""
    full = np.arange(64, dtype=np.uint16).reshape(8, 8, 1) * np.uint16(1000)
    flat = np.full((4, 4, 1), 31500, np.uint16)
    loss = compare("colour", flat, full, EVERYTHING)
    assert loss.at_full == pytest.approx(full.std() / 65535, rel=1e-3)


def test_heights_are_told_in_micrometres() -> None:
    a = np.zeros((8, 8), np.float32)
    assert compare("height", a + np.float32(0.002), a, EVERYTHING).at_full == pytest.approx(2)


def test_pixels_computed_include_halos() -> None:
    what = Description("n", ("a",), ("x",), stride=8, halo=16)
    assert computed((64, 32), 32, what) == 2 * (32 + 32) ** 2
    assert computed((64, 32), 64, what) == (64 + 32) * (32 + 32)


def test_windows_lie_within_the_chart_on_whole_texels() -> None:
    weight = np.zeros((384, 576))
    weight[0, 575] = 1
    corner = Window.around(weight, 1000)
    assert (corner.left, corner.top, corner.side) == (6144 - 960, 0, 960)
    middle = Window.around(weight * 0, 1536)
    assert (middle.left, middle.top) == (2304, 1280)
    for width in (6144, 3072, 1536, 768, 576, 288):
        part = middle.of(np.zeros((width * 2 // 3, width)))
        assert part.shape == (middle.pixels(width),) * 2


@pytest.mark.parametrize("extent", [FULL, QUICK])
def test_each_stage_begins_with_its_reference_and_repeats_nothing(extent: object) -> None:
    found = list(variants(extent, STAGES, ["wide"]))  # type: ignore[arg-type]
    assert len(set(found)) == len(found)
    for stage in STAGES:
        mine = [variant for variant in found if variant.stage == stage]
        assert mine[0] == reference(stage)
        assert len({variant.label for variant in mine}) == len(mine), "two rows would look the same"
    assert all(one.width <= FULL_SIZE[0] for one in found)
    assert [coding(knob)[1] for knob in CODINGS[:2]] == [16, 8]


def test_a_file_keeps_the_text_around_its_tables() -> None:
    text = put("# Title\n\nWords.\n", "one\n")
    assert text == f"# Title\n\nWords.\n\n{MARK[0]}\none\n{MARK[1]}\n"
    assert put(text + "\nAfter.\n", "two\n") == text.replace("one", "two") + "\nAfter.\n"


def test_memory_is_that_of_the_measured_process_alone() -> None:
    held = np.ones(50_000_000)
    assert isolated(peak_rss_mb) < 0.8 * peak_rss_mb()
    assert held[0] == 1


def leave() -> None:
    import os

    os._exit(9)


def test_a_process_that_dies_is_a_fault_not_a_hang() -> None:
    with pytest.raises(Crashed, match="leave"):
        isolated(leave)


def test_families_are_folders_with_a_table(tmp_path: Path) -> None:
    shipped, wide = tmp_path / "shipped", tmp_path / "more" / "wide"
    for folder in (shipped, wide):
        folder.mkdir(parents=True)
        write_models(folder, {"rho": toy_net("rho", ["a"], ["x"])})
    assert [family.name for family in find_families(None, shipped)] == ["shipped"]
    for place in (wide, wide.parent):
        assert [family.name for family in find_families(place, shipped)] == ["shipped", "wide"]
    with pytest.raises(UsageError, match=r"has no models\.json"):
        find_families(tmp_path / "none", shipped)


def test_engines_in_words() -> None:
    """Whoever reads a row of the whole has to see which networks ran on something else."""
    assert engine_in_words(Engine()) == "onnxruntime fp32"
    mixed = Engine(exceptions=frozenset({"zeta_tail", "zeta_body"}))
    assert engine_in_words(mixed) == "onnxruntime fp32 (zeta_body, zeta_tail: openvino fp32)"
