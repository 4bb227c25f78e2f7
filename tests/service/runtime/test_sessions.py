from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from service.errors import ModelFault, NumericFault
from service.runtime.sessions import MODELS, checked_bytes, load_session, model_table


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    for name in ("models.json", "face_mesh.onnx"):
        shutil.copy(MODELS / name, tmp_path / name)
    return tmp_path


def test_every_listed_file_is_there_and_unchanged() -> None:
    for name, entry in model_table().items():
        assert len(checked_bytes(name)) == entry["bytes"]
        assert entry["licence"]
        assert entry["source"]


def test_every_network_runs_on_its_stated_input() -> None:
    for name, entry in model_table().items():
        if "image" not in entry.get("inputs", {}):  # networks of maps are described in their files
            continue
        session = load_session(name)
        results = session.run({"image": np.zeros(entry["inputs"]["image"]["shape"], np.float32)})
        assert {n: list(r.shape) for n, r in zip(session.outputs, results, strict=True)} == entry["outputs"]


def test_a_flipped_bit_is_refused_by_name_and_hashes(copied: Path) -> None:
    path = copied / "face_mesh.onnx"
    data = bytearray(path.read_bytes())
    expected = hashlib.sha256(data).hexdigest()
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(ModelFault) as caught:
        load_session("face_mesh", folder=copied)
    assert str(path) in caught.value.message
    assert expected in caught.value.message
    assert hashlib.sha256(data).hexdigest() in caught.value.message


def test_a_missing_file_and_a_broken_table_are_named(copied: Path) -> None:
    (copied / "face_mesh.onnx").unlink()
    with pytest.raises(ModelFault, match=r"face_mesh\.onnx"):
        load_session("face_mesh", folder=copied)
    (copied / "models.json").write_text("{")
    with pytest.raises(ModelFault, match=r"models\.json"):
        load_session("face_mesh", folder=copied)


def test_a_listed_file_that_is_no_network_is_refused(copied: Path) -> None:
    data = b"not a network"
    (copied / "face_mesh.onnx").write_bytes(data)
    entry = {"name": "face_mesh", "file": "face_mesh.onnx", "sha256": hashlib.sha256(data).hexdigest()}
    (copied / "models.json").write_text(json.dumps({"models": [entry]}))
    with pytest.raises(ModelFault, match="cannot load"):
        load_session("face_mesh", folder=copied)


def test_an_unknown_name_tells_what_there_is() -> None:
    with pytest.raises(ModelFault, match="face_detector"):
        load_session("nothing")


def test_threads_must_be_positive() -> None:
    with pytest.raises(ValueError, match="threads"):
        load_session("face_mesh", threads=0)


def test_nan_does_not_go_in() -> None:
    image = np.zeros((1, 192, 192, 3), np.float32)
    image[0, 0, 0, 0] = np.nan
    with pytest.raises(NumericFault, match="input image has 1 of"):
        load_session("face_mesh").run({"image": image})


def test_overflow_does_not_come_out() -> None:
    with pytest.raises(NumericFault, match="output"):
        load_session("face_mesh").run({"image": np.full((1, 192, 192, 3), 3e38, np.float32)})


def test_a_wrong_shape_is_a_model_fault_with_the_shape() -> None:
    with pytest.raises(ModelFault, match=r"\(1, 5, 5, 3\)"):
        load_session("face_mesh").run({"image": np.zeros((1, 5, 5, 3), np.float32)})
