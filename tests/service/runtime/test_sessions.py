"""Model files, runtimes, silence and memory."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from service.errors import ModelFault, NumericFault
from service.runtime.sessions import (
    MODELS,
    has_openvino,
    load_session,
    model_table,
)


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    for name in ("models.json", "face_mesh.onnx"):
        shutil.copy(MODELS / name, tmp_path / name)
    return tmp_path


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


PROGRAM = """
import contextlib, sys
import numpy as np
from service.runtime.sessions import prompt_release, release

def resident():
    return int(open("/proc/self/statm").read().split()[1]) * 4096

for _ in range(3):
    np.ones(20 << 20, np.uint8)  # freed at once: lets the C library get used to blocks of that size
before = resident()
with prompt_release() if sys.argv[1] == "prompt" else contextlib.nullcontext():
    blocks, small = [], []
    for _ in range(10):
        blocks.append(np.ones(20 << 20, np.uint8))
        small.append(np.ones(100_000, np.uint8))
    blocks.clear()
    if sys.argv[1] == "later":
        release()
    print(resident() - before)
"""


def test_freed_blocks_go_back_at_once_or_when_told() -> None:
    """Left alone, the C library keeps 200 MB for later; if it ever does not, the measure can go."""
    kept = {}
    for way in ("prompt", "later", "plain"):
        done = subprocess.run([sys.executable, "-c", PROGRAM, way], capture_output=True, text=True, check=True)
        kept[way] = int(done.stdout)
    assert max(kept["prompt"], kept["later"]) < 16 << 20 < kept["plain"]


STARVED = """
import resource, sys
import cv2
import numpy as np
from service.errors import OutOfMemory
from service.runtime.sessions import lacked_memory
from service.runtime.networks import choose_engine, open_network

def limit(room):
    held = next(int(line.split()[1]) << 10 for line in open("/proc/self/status") if line.startswith("VmData"))
    resource.setrlimit(resource.RLIMIT_DATA, (held + room, resource.getrlimit(resource.RLIMIT_DATA)[1]))

library = sys.argv[1]
try:
    if library in ("onnxruntime", "openvino"):
        with open_network("zeta_tail", choose_engine(library, threads=1)) as network:
            maps = np.zeros((len(network.description.channels), 128, 128), np.float32)
            limit(10 << 20)
            network.run(maps)
    else:
        small = np.zeros((1000, 1000, 3), np.uint8)
        limit(10 << 20)
        cv2.resize(small, (9000, 9000)) if library == "opencv" else np.zeros((9000, 9000))
except OutOfMemory:
    print("told")
except Exception as error:
    print("told" if library in ("opencv", "numpy") and lacked_memory(error) else repr(error))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="no limit on memory elsewhere")
@pytest.mark.parametrize("library", ["onnxruntime", "openvino", "opencv", "numpy"])
def test_a_library_without_memory_is_known_by_what_it_says(library: str) -> None:
    """Taken for a damaged model it would stop the worker, and the job would not be tried with less memory."""
    if library == "openvino":
        pytest.importorskip("openvino")
    done = subprocess.run([sys.executable, "-c", STARVED, library], capture_output=True, text=True, check=True)
    assert done.stdout.split()[-1:] == ["told"], done.stdout


ROOT = Path(__file__).parents[3]

SILENT = """
import os
from service.face.detection import Detector
Detector()
handles = [f"/proc/self/fd/{handle}" for handle in os.listdir("/proc/self/fd")]
links = [os.readlink(handle) for handle in handles if os.path.exists(handle)]
print([link for link in links if link.startswith("socket") or ".db" in link])
"""


@pytest.mark.parametrize("given", [None, "0"])
def test_a_loaded_network_leaves_no_trace(tmp_path: Path, given: str | None) -> None:
    """onnxruntime 1.31 writes a device id and a data base of events under the home folder, and uploads them,
    unless it is told not to before it loads. Whatever the environment says, this program tells it.
    """
    environment = {**os.environ, "HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    environment.pop("ORT_DISABLE_TELEMETRY", None)
    if given is not None:
        environment["ORT_DISABLE_TELEMETRY"] = given
    child = subprocess.run(
        [sys.executable, "-c", SILENT], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    assert child.stdout.strip() == "[]"
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


IMPORT = """
import os, sys
forks = []
os.register_at_fork(before=lambda: forks.append(1))
from service.runtime.sessions import openvino_library
openvino_library().Core()
print(len(forks), any(name.startswith("openvino_telemetry.") for name in sys.modules))
"""


@pytest.mark.skipif(not has_openvino(), reason="OpenVINO is not installed")
def test_openvino_reports_to_nobody(tmp_path: Path) -> None:
    """Its import writes an id under the home folder and forks a process that calls its makers, unless it is kept from
    it. The fork hung the program where another thread multiplied matrices meanwhile.
    """
    environment = {**os.environ, "HOME": str(tmp_path)}
    child = subprocess.run(
        [sys.executable, "-c", IMPORT], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    assert child.stdout.split() == ["0", "False"]
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
