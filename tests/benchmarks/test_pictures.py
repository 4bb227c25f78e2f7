"""Differences of pictures: closed forms, an empty mask, the picture of them."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.pictures import Difference, draw, table

SHAPE = (10, 20)


def pair(off: float) -> Difference:
    """Pictures that differ by ``off`` in one channel of the left half, and by everything in the right one."""
    ours, mask = np.full((*SHAPE, 3), 0.5), np.zeros(SHAPE, bool)
    theirs = ours.copy()
    theirs[:, :10, 1] += off
    theirs[:, 10:] = 1.0
    mask[:, :10] = True
    return Difference.of(ours, theirs, mask)


def test_only_what_counts_is_compared() -> None:
    found = pair(0.3)
    assert (found.mean, found.high, found.pixels) == pytest.approx((25.5, 25.5, 100))
    assert table({"lamp": found}, "light").splitlines()[2] == "| lamp | 25.50 | 25.50 | 100 |"


def test_nothing_to_compare_is_an_error() -> None:
    """A mean over nothing would be printed as nan."""
    with pytest.raises(ValueError, match="mask is empty"):
        Difference.of(np.zeros((4, 4, 3)), np.ones((4, 4, 3)), np.zeros((4, 4), bool))


def test_the_picture_has_a_row_each_and_shows_differences_eightfold(tmp_path: Path) -> None:
    draw({"a": pair(0.1), "b": pair(0.0)}, tmp_path / "rows.png")
    image = np.asarray(cv2.imread(str(tmp_path / "rows.png")))[..., ::-1]
    assert image.shape == (20, 60, 3)
    assert (image[:10, 40:50] == [0, 204, 0]).all()
    assert not image[:10, 50:].any() and not image[10:, 40:].any()


@pytest.mark.parametrize(("name", "arguments"), [("light_against_mitsuba", []), ("render_against_mitsuba", ["a.zip"])])
def test_both_comparisons_print_their_table_and_draw(
    name: str, arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Minutes of rendering must not end in nothing."""
    pytest.importorskip("torch")
    module = import_module(f"benchmarks.{name}")
    monkeypatch.setattr(module, "compare", lambda *_: {"lamp": pair(0.3)})
    monkeypatch.setattr(sys, "argv", [name, *arguments, "--image", str(tmp_path / "rows.png")])
    module.main()
    assert "| lamp | 25.50 | 25.50 | 100 |" in capsys.readouterr().out
    assert (tmp_path / "rows.png").is_file()
