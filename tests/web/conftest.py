from __future__ import annotations

import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.browser import PHOTO, ROOT
from tests.web.archives import with_reflectance
from tests.web.fake_service import Fake, serving


@pytest.fixture(scope="session")
def plain_archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An archive of the program itself, with the maps that need no networks."""
    target = tmp_path_factory.mktemp("archive") / "plain.zip"
    maps = ("--maps", "texture,confidence,shape_normal")
    command = [sys.executable, "-m", "service", "make", str(PHOTO), "-o", str(target), *maps]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    assert zipfile.is_zipfile(target)
    return target


@pytest.fixture(scope="session")
def archive(plain_archive: Path) -> Path:
    """The same with all maps that there are."""
    target = plain_archive.with_name("full.zip")
    with_reflectance(plain_archive, target)
    return target


@pytest.fixture
def fake(archive: Path) -> Iterator[Fake]:
    with serving(archive) as service:
        yield service
