"""One command that makes data and trains: it shares its time, and goes on where it stopped."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

import models.training.all as everything  # noqa: E402
from models.lightstage.split import HELD_OUT, TRAIN, subject_part  # noqa: E402
from models.training.all import HELD_OUT_EVERY, SHARES, captured, device_named, main, turns  # noqa: E402
from models.training.train import TASKS  # noqa: E402
from service.errors import UsageError  # noqa: E402

pytestmark = pytest.mark.train


def test_held_out_subjects_come_early_and_seldom() -> None:
    first = list(islice(turns(), 2 * HELD_OUT_EVERY))
    assert [part for _, part in first].count(HELD_OUT) == 2
    assert first[0][1] == TRAIN and first[1][1] == HELD_OUT
    assert all(subject_part(seed) == part for seed, part in first)
    assert len({seed for seed, _ in first}) == len(first)


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


def test_the_device_is_one_that_is_there() -> None:
    assert device_named("cpu") == "cpu"
    assert device_named("auto") == ("cuda" if torch.cuda.is_available() else "cpu")
    with pytest.raises(UsageError, match="auto, cpu or cuda"):
        device_named("tpu")
    if not torch.cuda.is_available():
        with pytest.raises(UsageError, match="no accelerator"):
            device_named("cuda")


def test_what_does_not_exist_is_said(tmp_path: Path) -> None:
    assert set(SHARES) <= set(TASKS) and sum(SHARES.values()) == pytest.approx(1.0)
    with pytest.raises(UsageError, match="huge"):
        main(0.1, tmp_path, "cpu", "huge", "psi", 1, False)
    with pytest.raises(UsageError, match="omega"):
        main(0.1, tmp_path, "cpu", "compact", "omega", 1, False)
