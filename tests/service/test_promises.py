"""``docs/promises.md`` names tests that exist, and codes that have an explanation."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from service.api.problem_responses import EXPLANATIONS
from service.jobs.view import TITLES

TESTS = Path(__file__).parents[1]
ROWS = re.findall(r"^\| \d+ \| .* \|$", (TESTS.parent / "docs" / "promises.md").read_text("utf-8"), re.MULTILINE)


def test_the_rows_are_found() -> None:
    assert len(ROWS) == 48 + 17


@pytest.mark.parametrize("row", ROWS)
def test_each_row_has_its_tests_and_its_codes(row: str) -> None:
    _, _, answer, proof = (cell.strip() for cell in row.strip("| ").split(" | "))
    files = re.findall(r"`([\w/]+\.py)`: ((?:`\w+`(?:, )?)+)", proof)
    assert files
    for path, names in files:
        tree = ast.parse((TESTS / path).read_text("utf-8"))
        assert set(re.findall(r"\w+", names)) <= {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    for status, code in re.findall(r"(\d{3}) ([a-z]+(?:-[a-z]+)+|usage|animated|busy|gone|draining)", answer):
        assert 400 <= int(status) < 600
        assert code in {*EXPLANATIONS, *TITLES}, "a code without an explanation"
