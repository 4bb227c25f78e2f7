"""Photos that are there are not taken again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import render
from benchmarks.heads import TexturedHead
from benchmarks.render import Shot, take_once


def test_a_photo_is_taken_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that was broken off goes on where it was; what lacks its truth was broken off itself."""
    taken = []

    def take(head: TexturedHead, shot: Shot, out: Path, samples: int) -> None:
        taken.append(samples)
        Path(f"{out}.npz").write_bytes(b"")

    monkeypatch.setattr(render, "take", take)
    nobody = TexturedHead("nobody", np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros((0, 3)), np.zeros((2, 3)), 1)
    (tmp_path / "photo.png").write_bytes(b"half")
    assert take_once(nobody, Shot(0, "soft", 1, 20), tmp_path / "photo", 16)
    assert not take_once(nobody, Shot(0, "soft", 1, 20), tmp_path / "photo", 16)
    assert taken == [16]
