"""EXR files are read back by a reader that shares no code with the writer."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from service.archive.exr import exr_bytes

READ = """
import sys, cv2, numpy as np
image = cv2.imread(sys.argv[1], cv2.IMREAD_UNCHANGED)
np.save(sys.argv[2], image if image.ndim == 2 else image[..., ::-1])
"""


@pytest.mark.parametrize("shape", [(37, 21), (37, 21, 3), (16, 1, 3), (1, 5)])
def test_opencv_reads_the_same(shape: tuple[int, ...], tmp_path: Path) -> None:
    """In a process of its own, as OpenCV reads EXR only where its environment says so."""
    image = np.random.default_rng(4).uniform(-1, 2, shape).astype(np.float32)
    image.reshape(-1)[: image.size // 2] = 0.25  # a part that compresses
    (tmp_path / "a.exr").write_bytes(exr_bytes(image))
    command = [sys.executable, "-c", READ, str(tmp_path / "a.exr"), str(tmp_path / "a.npy")]
    done = subprocess.run(command, env=os.environ | {"OPENCV_IO_ENABLE_OPENEXR": "1"}, capture_output=True, text=True)
    if "codec is disabled" in done.stderr or "nothing was read" in done.stderr:
        pytest.skip("this OpenCV is built without OpenEXR")
    assert done.returncode == 0, done.stderr
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), image.astype(np.float16).astype(np.float32))


def test_another_shape_is_refused() -> None:
    with pytest.raises(ValueError, match=r"\(2, 2, 2\)"):
        exr_bytes(np.zeros((2, 2, 2), np.float32))
