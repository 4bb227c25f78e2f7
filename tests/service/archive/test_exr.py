"""EXR files are read back by a reader that shares no code with the writer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from service.archive.exr import exr_bytes


@pytest.mark.parametrize("shape", [(37, 21), (37, 21, 3), (16, 1, 3), (1, 5)])
def test_another_reader_reads_the_same(shape: tuple[int, ...], tmp_path: Path) -> None:
    mitsuba = pytest.importorskip("mitsuba", reason="no reader of EXR: pip install mitsuba")
    mitsuba.set_variant("scalar_rgb")
    image = np.random.default_rng(4).uniform(-1, 2, shape).astype(np.float32)
    image.reshape(-1)[: image.size // 2] = 0.25  # a part that compresses
    (tmp_path / "a.exr").write_bytes(exr_bytes(image))
    read = np.array(mitsuba.Bitmap(str(tmp_path / "a.exr")))
    np.testing.assert_array_equal(read.reshape(shape).astype(np.float32), image.astype(np.float16).astype(np.float32))


def test_another_shape_is_refused() -> None:
    with pytest.raises(ValueError, match=r"\(2, 2, 2\)"):
        exr_bytes(np.zeros((2, 2, 2), np.float32))
