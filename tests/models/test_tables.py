"""Tables in files are replaced between their marks, and only there."""

from __future__ import annotations

from pathlib import Path

from models.tables import write_between

MARK = ("<!-- a -->", "<!-- /a -->")


def test_only_what_stands_between_the_marks_changes(tmp_path: Path) -> None:
    file = tmp_path / "page.md"
    file.write_text(f"before\n{MARK[0]}\nold\n{MARK[1]}\nafter\n", "utf-8")
    write_between(file, MARK, "new\n")
    assert file.read_text("utf-8") == f"before\n{MARK[0]}\nnew\n{MARK[1]}\nafter\n"
