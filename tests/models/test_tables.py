"""Tables in files are replaced between their marks, and only there."""

from __future__ import annotations

from pathlib import Path

import pytest

from models.tables import tell, write_between

MARK = ("<!-- a -->", "<!-- /a -->")


def test_only_what_stands_between_the_marks_changes(tmp_path: Path) -> None:
    file = tmp_path / "page.md"
    file.write_text(f"before\n{MARK[0]}\nold\n{MARK[1]}\nafter\n", "utf-8")
    write_between(file, MARK, "new\n")
    assert file.read_text("utf-8") == f"before\n{MARK[0]}\nnew\n{MARK[1]}\nafter\n"


def test_a_file_without_marks_is_left_alone(tmp_path: Path) -> None:
    """A long measurement must not end by emptying a page."""
    file = tmp_path / "page.md"
    file.write_text("words\n", "utf-8")
    with pytest.raises(SystemExit, match="no lines"):
        write_between(file, MARK, "new")
    assert file.read_text("utf-8") == "words\n"


def test_a_table_is_printed_and_put_where_a_file_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "page.md"
    file.write_text(f"{MARK[0]}\n{MARK[1]}\n", "utf-8")
    tell("one", MARK, None)
    assert file.read_text("utf-8") == f"{MARK[0]}\n{MARK[1]}\n"
    tell("two", MARK, file)
    assert file.read_text("utf-8") == f"{MARK[0]}\ntwo\n{MARK[1]}\n"
    assert capsys.readouterr().out == "one\ntwo\n"
