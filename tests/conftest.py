"""What holds for every test."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

# As the command line does, and before any test loads numpy: OpenBLAS spins where another process has the core.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from tests.support.browser import browser, open_page  # noqa: F401 - fixtures of whoever looks at a page


@pytest.fixture(autouse=True)
def _environment_as_it_was() -> Iterator[None]:
    """A variable that a test or the tested code leaves behind would reach every test after it."""
    before = dict(os.environ)
    yield
    kept = {name: value for name, value in os.environ.items() if name != "PYTEST_CURRENT_TEST"}
    if kept != {name: value for name, value in before.items() if name != "PYTEST_CURRENT_TEST"}:
        os.environ.clear()
        os.environ.update(before)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The product's tests first: they take longest, and the short ones fill what is left of both cores."""
    items.sort(key=lambda item: not item.nodeid.startswith("tests/product/"))


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Files that are slow as a whole, or for training, are not even imported where those are left out."""
    if collection_path.suffix != ".py":
        return None
    left_out = "|".join(re.findall(r"not (slow|train)", config.option.markexpr))
    marked = rf"^pytestmark = (\[[^\]]*)?pytest\.mark\.({left_out})\b"
    return True if left_out and re.search(marked, collection_path.read_text("utf-8"), re.MULTILINE) else None
