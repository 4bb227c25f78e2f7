from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from service import diagnosis
from service.cli import bench_and_doctor as doctor
from service.errors import ModelFault

ROOT = Path(__file__).parents[3]


@pytest.fixture
def trial_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    trial = {"seconds": 1.0, "archive_bytes": 10, "landmark_rms_px": 0.5, "warnings": []}
    monkeypatch.setattr(doctor, "self_test", lambda: (trial, []))


@pytest.mark.slow
def test_the_shipped_installation_is_well() -> None:
    child = subprocess.run([sys.executable, "-m", "service", "doctor", "--json"], cwd=ROOT, capture_output=True)
    findings = json.loads(child.stdout)
    assert findings["faults"] == []
    assert child.returncode == 0
    assert findings["self_test"]["archive_bytes"] > 100_000
    assert findings["self_test"]["seconds"] > 0


@pytest.mark.usefixtures("trial_left_out")
def test_a_changed_data_file_is_told_and_ends_with_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(diagnosis, "data_faults", lambda: ["head.npz has sha256 0; shipped was 1"])
    with pytest.raises(typer.Exit) as leaving:
        doctor.doctor(as_json=False)
    assert leaving.value.exit_code == 1
    out = capsys.readouterr().out
    assert "FAULT      head.npz has sha256 0; shipped was 1" in out
    assert "all is well" not in out


@pytest.mark.usefixtures("trial_left_out")
def test_a_missing_library_and_a_missing_list_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone() -> dict[str, str]:
        raise ModelFault("SHA256SUMS cannot be read")

    monkeypatch.setattr(diagnosis, "shipped_files", gone)
    monkeypatch.setattr(diagnosis, "library_versions", lambda: dict.fromkeys(diagnosis.REQUIRED + diagnosis.OPTIONAL))
    faults = doctor.examine()["faults"]
    assert "onnxruntime is not installed" in faults
    assert "openvino is not installed" not in faults, "optional"
    assert "SHA256SUMS cannot be read" in faults


def test_a_failing_pipeline_is_a_finding_not_a_crash(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(diagnosis, "SAMPLE", tmp_path / "gone.png")
    trial, faults = doctor.self_test()
    assert trial == {}
    assert len(faults) == 1
    assert faults[0].startswith("self-test failed: ")
