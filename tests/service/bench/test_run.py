"""The benchmark on toy networks, in this process."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from service.bench.report import as_markdown, draw
from service.bench.run import run_bench
from service.bench.sample_head import write_sample_head
from service.bench.stages import rule_notes
from service.bench.variants import STAGES, Bench, BenchExtent, Family, MeasuredStage, Row, reference
from service.errors import ModelFault, UsageError
from service.runtime.networks import Engine
from service.runtime.sessions import model_table
from tests.service.reflectance.toys import noise, toy_folder, toy_subject

TINY = BenchExtent(256, (3072,), (128,), 128, (0.0,), (), (), False, 0)


@pytest.fixture
def toys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Family:
    def from_subject(photo: bytes, size: object, side: int, folder: Path) -> None:
        texture = noise()
        write_sample_head(toy_subject(), texture, np.ones(texture.shape[:2]), side, folder)

    monkeypatch.setattr("service.bench.run.from_photo", from_subject)
    folder = tmp_path / "toys"
    folder.mkdir()
    toy_folder(folder)
    return Family("toys", folder, tuple(model_table(folder)))


def by_label(found: Bench, stage: str) -> dict[str, float]:
    rows = [row for row in found.rows if row.variant.stage == stage]
    assert not [row.fault for row in rows if row.fault]
    return {row.variant.label: row.loss.at_full for row in rows if row.loss}


def here(work, *arguments):  # type: ignore[no-untyped-def]
    """In this process."""
    return work(*arguments)


def test_every_stage_in_every_variant(toys: Family, tmp_path: Path) -> None:
    found = run_bench(TINY, [toys], launch=here)
    assert {row.variant.stage for row in found.rows} == set(STAGES)
    assert not [note for note in found.notes if "--runtime auto" not in note], "toys are no measure of runtimes"
    for stage in ("delta", "psi", "rho", "sigma"):
        loss = by_label(found, stage)
        assert loss["reference"] == 0
        assert loss["tile 128"] < 1e-4, "tiles with a full halo equal the whole"
        assert loss["tile 128, halo x 0"] > 10 * loss["tile 128"] + 1e-6, "no halo has to show"
    heights = by_label(found, "integration")
    assert heights["tolerance 0.003"] <= heights["tolerance 0.3"]
    assert by_label(found, "encoding")["normals 8 bits, in strips"] < 0.5
    for row in found.rows:
        if row.variant.reference and row.variant.stage not in ("integration", "encoding"):
            assert row.measured
            assert row.measured.seconds > 0
    assert any(row.front for row in found.rows)
    json.dumps(found.to_json(), allow_nan=False)
    text = as_markdown(found)
    assert "| tile 128, halo x 0 |" in text
    pytest.importorskip("matplotlib")
    draw(found, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 10_000


def test_a_rule_that_is_wrong_on_this_machine_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever reads the table of a new processor has to see that ``auto`` takes the slower runtime there."""
    slow, fast = (MeasuredStage(seconds, seconds, 1.0) for seconds in (3.0, 1.0))
    plain = reference("rho")
    other = replace(plain, runtime="openvino")
    folder = Family("none", Path(), ())
    monkeypatch.setattr("service.bench.stages.choose_engine", lambda **_: Engine(threads=1))
    told = "rho: --runtime auto takes onnxruntime fp32; openvino fp32 was 3.00 times as fast in this run"
    assert rule_notes([Row(plain, slow), Row(other, fast)], 1, folder) == [told]
    assert rule_notes([Row(plain, fast), Row(other, slow)], 1, folder) == []


def test_what_is_not_there_is_left_out_and_told(toys: Family) -> None:
    few = Family("few", toys.folder, ("psi",))
    found = run_bench(TINY, [few], launch=here)
    assert {row.variant.stage for row in found.rows} == {"psi"}
    assert any(note.startswith("rho was left out") for note in found.notes)
    assert "rho was left out" in as_markdown(found)


def test_without_networks_there_is_nothing_to_measure(tmp_path: Path) -> None:
    with pytest.raises(ModelFault, match="--networks"):
        run_bench(TINY, [Family("none", tmp_path, ())], launch=here)


def test_the_plot_needs_matplotlib(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from service.cli.bench import bench as command

    (tmp_path / "networks").mkdir()
    toy_folder(tmp_path / "networks")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(UsageError, match="pip install matplotlib"):
        command(quick=True, as_json=False, output=str(tmp_path), networks=str(tmp_path / "networks"))
