from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from service import diagnosis
from service.archive.avatar import Avatar
from service.options import TEXTURE_MAPS, Options
from service.pipeline import make_avatar
from tests.end_to_end.command import Ran, avatarme

Pixels = npt.NDArray[np.uint8]
MADE = pytest.StashKey[Ran]()

QUICK = Options(size=(192, 128), maps=TEXTURE_MAPS)
"""Small maps, no networks: these tests look at the fit and at what the maps say of it."""

TEXTURE_ONLY = ("--maps", ",".join(TEXTURE_MAPS))
"""The same for the command; ``test_reflectance`` has the networks."""


@dataclass(frozen=True)
class Sample:
    """What ``avatarme make`` made of the sample photo."""

    run: Ran
    path: Path
    members: dict[str, bytes]
    manifest: dict[str, Any]


def unpacked(data: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert archive.testzip() is None
        return {name: archive.read(name) for name in archive.namelist()}


def png(pixels: Pixels, **options: Any) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG", compress_level=1, **options)
    return stream.getvalue()


@pytest.fixture(scope="session")
def sample(tmp_path_factory: pytest.TempPathFactory, pytestconfig: pytest.Config) -> Sample:
    path = tmp_path_factory.mktemp("sample") / "sample.zip"
    run = avatarme("make", diagnosis.SAMPLE, "-o", path, "--json", *TEXTURE_ONLY)
    assert run.status == 0, run.stderr
    pytestconfig.stash[MADE] = run
    members = unpacked(path.read_bytes())
    return Sample(run, path, members, json.loads(members["manifest.json"]))


@pytest.fixture(scope="session")
def portrait() -> Pixels:
    """(512, 512, 3): a frontal face of 105 pixels before a flag and a rocket."""
    return np.array(Image.open(diagnosis.SAMPLE).convert("RGB"))


@pytest.fixture(scope="session")
def make() -> Callable[[Pixels], Avatar]:
    """The pipeline on pixels, with small maps."""
    return lambda pixels: make_avatar(png(pixels), QUICK)


@pytest.fixture(scope="session")
def plain(portrait: Pixels, make: Callable[[Pixels], Avatar]) -> Avatar:
    """The avatar of the sample as it is, which the harder versions of it are compared with."""
    return make(portrait)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    run = config.stash.get(MADE, None)
    if run is not None:
        terminalreporter.write_line(f"avatarme make on the sample photo: {run}")
