"""What the pipeline says about itself; ``tests/end_to_end`` runs it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from service import pipeline
from service.ahead import FaceNetworks
from service.diagnosis import SAMPLE
from service.options import Options

ROOT = Path(__file__).parents[2]

FROM_A_LARGE_PROGRAM = """
import subprocess, sys
held = bytearray(b"x") * (600 << 20)
print(subprocess.run([sys.executable, "-c", sys.argv[1]], check=True, capture_output=True, text=True).stdout)
"""
OWN_PEAK = "from service.diagnosis import peak_rss_mb; print(peak_rss_mb())"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux counts the caller")
def test_the_memory_of_the_caller_is_not_counted() -> None:
    """A server of 600 MB that starts the command would read 600 MB for every avatar."""
    child = subprocess.run(
        [sys.executable, "-c", FROM_A_LARGE_PROGRAM, OWN_PEAK], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert 5 < float(child.stdout) < 500, "an interpreter has some 10 to 30 MB"


def test_a_fit_to_landmarks_reads_no_face_also_where_its_networks_are_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    class Reached(Exception):
        pass

    def fitted(*_: object) -> None:
        raise Reached

    monkeypatch.setattr(pipeline, "read_all", None)
    monkeypatch.setattr(pipeline, "fitted", fitted)
    with pytest.raises(Reached):
        pipeline.make_avatar(SAMPLE.read_bytes(), Options(fit="landmarks"), loaded=FaceNetworks(Options()))
