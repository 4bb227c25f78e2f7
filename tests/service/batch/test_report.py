from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from service.batch.report import Line, Report
from service.errors import OutputFault, UsageError


def line(path: str, attempt: int = 1) -> Line:
    return Line(
        path=path, sha256="0" * 64, options={"size": [96, 64]}, outcome="succeeded", archive="a.zip", attempt=attempt
    )


def paths(out: Path) -> list[str]:
    return [json.loads(text)["path"] for text in (out / "report.jsonl").read_text().splitlines()]


def test_lines_are_on_the_disk_at_once_and_in_order_at_the_end(tmp_path: Path) -> None:
    with Report(tmp_path / "out", resume=False) as report:
        report.add(line("b"))
        report.add(line("a"))
        assert paths(tmp_path / "out") == ["b", "a"]
    assert paths(tmp_path / "out") == ["a", "b"]


def test_the_last_line_of_a_photo_counts(tmp_path: Path) -> None:
    with Report(tmp_path, resume=False) as report:
        report.add(line("a"))
        report.add(line("a", 2))
    with Report(tmp_path, resume=True) as report:
        assert report.find("a") == line("a", 2)
        assert report.find("b") is None
    assert paths(tmp_path) == ["a"]


@pytest.mark.parametrize("torn", [b'{"path": "c", "sha', b"\0\0\0", b"[]\n", b'{"path": 7}\n', b"[" * 5000, b"\xff\n"])
def test_what_a_killed_program_left_half_written_does_no_harm(tmp_path: Path, torn: bytes) -> None:
    """The next line must not be glued to it either."""
    with Report(tmp_path, resume=False) as report:
        report.add(line("a"))
    with (tmp_path / "report.jsonl").open("ab") as stream:
        stream.write(torn)
    with Report(tmp_path, resume=True) as report:
        report.add(line("b"))
    assert paths(tmp_path) == ["a", "b"]


def test_a_report_of_tomorrow_is_read(tmp_path: Path) -> None:
    with Report(tmp_path, resume=False) as report:
        report.add(line("a"))
    text = (tmp_path / "report.jsonl").read_text()
    (tmp_path / "report.jsonl").write_text(text.replace('{"path"', '{"new": 1, "path"'))
    with Report(tmp_path, resume=True) as report:
        assert report.find("a") == line("a")


def test_a_name_that_is_no_text(tmp_path: Path) -> None:
    name = os.fsdecode(b"caf\xe9.jpg")
    with Report(tmp_path, resume=False) as report:
        report.add(line(name))
    with Report(tmp_path, resume=True) as report:
        assert report.find(name) == line(name)


def test_an_earlier_report_is_not_thrown_away_by_a_slip(tmp_path: Path) -> None:
    with Report(tmp_path, resume=False) as report:
        report.add(line("a"))
    with pytest.raises(UsageError, match="--resume"):
        Report(tmp_path, resume=False)
    assert paths(tmp_path) == ["a"]


def test_two_programs_do_not_share_a_folder(tmp_path: Path) -> None:
    with Report(tmp_path, resume=False), pytest.raises(UsageError, match="another batch"):
        Report(tmp_path, resume=True)
    with Report(tmp_path, resume=True):
        pass


def test_nothing_is_added_after_the_end(tmp_path: Path) -> None:
    """A thread that was left behind comes to its end after the report was closed."""
    with Report(tmp_path, resume=False) as report:
        pass
    report.add(line("late"))
    report.close()
    assert paths(tmp_path) == []


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputFault, match="file"):
        Report(tmp_path / "file" / "out", resume=False)
