"""EXR files are read back as the specification of the layout says, by code that shares nothing with the writer."""

from __future__ import annotations

import numpy as np
import pytest

from service.archive.images import exr_bytes
from tests.tools.exr import read


@pytest.mark.parametrize("shape", [(37, 21), (37, 21, 3), (16, 1, 3), (1, 5)])
def test_it_is_read_back(shape: tuple[int, ...]) -> None:
    image = np.random.default_rng(4).uniform(-1, 2, shape).astype(np.float32)
    image.reshape(-1)[: image.size // 2] = 0.25  # a part that compresses
    found = read(exr_bytes(image))
    planes = {"Y": image} if image.ndim == 2 else {name: image[..., "RGB".index(name)] for name in "RGB"}
    assert set(found) == set(planes)
    for name, plane in planes.items():
        np.testing.assert_array_equal(found[name], plane.astype(np.float16))


def test_another_shape_is_refused() -> None:
    with pytest.raises(ValueError, match=r"\(2, 2, 2\)"):
        exr_bytes(np.zeros((2, 2, 2), np.float32))
