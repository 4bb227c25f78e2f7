"""``docs/promises.md`` names tests that exist, and codes that have an explanation."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from service.api.problem_responses import EXPLANATIONS
from service.jobs.view import TITLES

TESTS = Path(__file__).parents[1]
SOURCES = "".join(file.read_text("utf-8") for file in TESTS.rglob("test_*.py"))
NAMES = set(re.findall(r"^def (test_\w+)", SOURCES, re.MULTILINE))
ROWS = re.findall(r"^\| \d+ \| .* \|$", (TESTS.parent / "docs" / "promises.md").read_text("utf-8"), re.MULTILINE)


def test_the_rows_are_found() -> None:
    assert len(ROWS) == 48 + 17


@pytest.mark.parametrize("row", ROWS)
def test_each_row_has_its_tests_and_its_codes(row: str) -> None:
    _, _, answer, proof = (cell.strip() for cell in row.strip("| ").split(" | "))
    assert proof
    assert set(re.findall(r"`(\w+)`", proof)) <= NAMES
    for status, code in re.findall(r"(\d{3}) ([a-z]+(?:-[a-z]+)+|usage|animated|busy|gone|draining)", answer):
        assert 400 <= int(status) < 600
        assert code in {*EXPLANATIONS, *TITLES}, "a code without an explanation"
