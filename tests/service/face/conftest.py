from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from export.faces.probes import sample_photo
from service.face.finder import Face, FaceFinder
from service.head.files import load_head
from service.head.model import HeadModel

Pixels = npt.NDArray[np.uint8]


@pytest.fixture(scope="session")
def finder() -> FaceFinder:
    return FaceFinder()


@pytest.fixture(scope="session")
def portrait() -> Pixels:
    """(512, 512, 3): a 105-pixel face before a flag and a rocket."""
    return sample_photo()


@pytest.fixture(scope="session")
def face(finder: FaceFinder, portrait: Pixels) -> Face:
    (found,) = finder.find(portrait)
    return found


@pytest.fixture(scope="session")
def head() -> HeadModel:
    return load_head()
