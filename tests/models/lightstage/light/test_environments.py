"""Decoding panoramas."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
mitsuba = pytest.importorskip("mitsuba", reason="mitsuba is not installed: pip install '.[dev]'")

from models.lightstage.light.environments import convert, reduced  # noqa: E402

pytestmark = pytest.mark.train


def module(image: np.ndarray, folder: Path) -> str:
    mitsuba.set_variant("scalar_rgb")
    file = folder / "image.exr"
    mitsuba.Bitmap(image.astype(np.float32)).write(str(file))
    return f"export default 'data:application/exr;base64,{base64.b64encode(file.read_bytes()).decode()}'"


def test_a_package_becomes_the_same_file_every_time(tmp_path: Path) -> None:
    image = np.random.default_rng(0).uniform(0.1, 2.0, (128, 256, 3))
    folder = tmp_path / "package" / "hdri"
    folder.mkdir(parents=True)
    (folder / "field.exr.js").write_text(module(image, tmp_path))
    assert convert(tmp_path / "package", tmp_path / "a.npz") == ["field"]
    convert(tmp_path / "package", tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        ratio = archive["field"].astype(float) / reduced(image).astype(float)
    np.testing.assert_allclose(ratio, 1.0, atol=2e-3)
