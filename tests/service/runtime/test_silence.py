"""The inference runtime reports nothing to anybody."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from service.runtime.sessions import has_openvino

ROOT = Path(__file__).parents[3]

PROGRAM = """
import os
from service.face.detector import Detector
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
        [sys.executable, "-c", PROGRAM], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
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
