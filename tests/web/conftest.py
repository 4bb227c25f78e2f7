from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.browser import PHOTO, ROOT
from tests.web.fake_service import Fake, serving


@pytest.fixture(scope="session")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small draft of the sample photo."""
    target = tmp_path_factory.mktemp("archive") / "sample.zip"
    flags = ("--quality", "draft", "--size", "384x256")
    command = [sys.executable, "-m", "service", "make", str(PHOTO), "-o", str(target), *flags]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return target


@pytest.fixture
def fake(archive: Path) -> Iterator[Fake]:
    with serving(archive) as service:
        yield service
