"""The quantisation steps of a JPEG file."""

from __future__ import annotations

import cv2
import numpy as np

from service.photo.gate import read_photo

FIFTY = (16, 11, 10, 16, 24, 40, 51, 61)
"""First row of table K.1 of T.81, which encoders use at quality 50."""


def photo(quality: int, kind: str = ".jpg") -> bytes:
    image = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    return cv2.imencode(kind, image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def test_steps_are_those_of_the_standard() -> None:
    steps = read_photo(photo(50)).steps
    assert steps is not None
    assert tuple(np.rint(255 * steps[0]).astype(int)) == FIFTY
    assert round(255 * float(steps[7, 0])) == 72


def test_better_files_have_smaller_steps() -> None:
    means = [float(np.mean(read_photo(photo(quality)).steps)) for quality in (50, 75, 95)]  # type: ignore[arg-type]
    assert means[0] > means[1] > means[2] > 0


def test_other_formats_have_none() -> None:
    assert read_photo(photo(0, ".png")).steps is None
