"""One command that makes data and trains: it shares its time, and goes on where it stopped."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("torch")

import models.training.all as everything
from models.lightstage.split import HELD_OUT, TRAIN
from models.training.all import captured

pytestmark = pytest.mark.train


def test_drawing_ends_in_time_but_not_before_each_part_has_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    drawn: list[str] = []
    now = [0.0]

    def draw(seed: int, pose: str, part: str, *_: object) -> Path:
        now[0] += 10.0
        drawn.append(part)
        return tmp_path

    monkeypatch.setattr(everything, "draw", draw)
    assert captured(tmp_path, "cpu", 0.0, lambda: now[0]) == 2
    assert set(drawn) == {TRAIN, HELD_OUT}
    now[0] = 0.0
    assert captured(tmp_path, "cpu", 95.0, lambda: now[0]) == 10
    monkeypatch.setattr(everything, "draw", lambda *_: now.__setitem__(0, now[0] + 10.0))
    now[0] = 0.0
    assert captured(tmp_path, "cpu", 30.0, lambda: now[0]) == 0, "files that were there are not new"
