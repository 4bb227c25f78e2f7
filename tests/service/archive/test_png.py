"""PNG in strips: read back by two decoders that nobody here wrote, whatever the size and depth."""

from __future__ import annotations

import io

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from service.archive.images import STRIP_ROWS, Rows, encode_png_rows

RNG = np.random.default_rng(8)


def noise(shape: tuple[int, ...], bits: int) -> npt.NDArray[np.uint8] | npt.NDArray[np.uint16]:
    if bits == 8:
        return RNG.integers(0, 256, shape, np.uint8)
    return RNG.integers(0, 65536, shape, np.uint16)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("channels", [(), (3,), (4,)])
@pytest.mark.parametrize("size", [(1, 1), (1, 7), (STRIP_ROWS, 3), (STRIP_ROWS + 1, 5), (3 * STRIP_ROWS - 1, 40)])
def test_what_goes_in_comes_out(size: tuple[int, int], channels: tuple[int, ...], bits: int) -> None:
    """One row, one column, strips that end with the image and strips that do not."""
    image = noise((*size, *channels), bits)
    data = encode_png_rows(Rows.of(image), srgb=False)
    found = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED))
    if channels:
        found = found[..., [2, 1, 0, 3][: channels[0]]]
    np.testing.assert_array_equal(found, image)
    assert found.dtype == image.dtype
    with Image.open(io.BytesIO(data)) as opened:
        opened.load()  # Pillow checks every chunk's sum
        assert opened.size == size[::-1] and "srgb" not in opened.info


def test_colours_say_that_they_are_srgb() -> None:
    with Image.open(io.BytesIO(encode_png_rows(Rows.of(noise((4, 5, 3), 8)), srgb=True))) as opened:
        assert opened.info["srgb"] == 0


def test_rows_are_asked_for_once_and_in_order() -> None:
    """Maps are computed as they are written; a second look at a strip would compute it twice."""
    image, asked = noise((2 * STRIP_ROWS + 9, 6), 16), []

    def read(first: int, last: int) -> npt.NDArray[np.uint8] | npt.NDArray[np.uint16]:
        asked.append((first, last))
        return image[first:last]

    assert encode_png_rows(Rows(image.shape, 16, read), srgb=False) == encode_png_rows(Rows.of(image), srgb=False)
    assert asked == [(0, STRIP_ROWS), (STRIP_ROWS, 2 * STRIP_ROWS), (2 * STRIP_ROWS, 2 * STRIP_ROWS + 9)]


@pytest.mark.parametrize(("shape", "bits"), [((4, 4, 2), 8), ((4, 4), 12), ((0, 4), 8), ((4, 0, 3), 16)])
def test_what_png_does_not_have(shape: tuple[int, ...], bits: int) -> None:
    with pytest.raises(ValueError, match="PNG has no"):
        rows = Rows(shape, bits, lambda first, last: np.zeros((last - first, *shape[1:]), np.uint8))
        encode_png_rows(rows, srgb=False)
