from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from service import diagnosis
from service.archive.avatar import Avatar
from service.options import TEXTURE_MAPS, Options
from service.pipeline import make_avatar

Pixels = npt.NDArray[np.uint8]

QUICK = Options(size=(192, 128), maps=TEXTURE_MAPS, hair="none")
"""Small maps, no networks, no hair: these tests look at the fit and at what the maps say of it."""

TEXTURE_ONLY = ("--maps", ",".join(TEXTURE_MAPS), "--hair", "none")
"""The same for the command; ``tests/product`` has the networks and the hair."""


def unpacked(data: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert archive.testzip() is None
        return {name: archive.read(name) for name in archive.namelist()}


def png(pixels: Pixels, **options: Any) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG", compress_level=1, **options)
    return stream.getvalue()


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
