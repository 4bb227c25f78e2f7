"""Octaves of detail on a chart: a Laplacian pyramid (Burt and Adelson 1983), counted in texels of the full map.

Octave k has periods of ``2^(k+1)`` to ``2^(k+2)`` texels. An image is worked on in strips with so much around them that
any strips give what the whole gives. Down it goes by means, up bicubically: the usual kernel of five passes half of
an octave into the next, so that made-up pores would lie over the photo's spots.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.arrays import Float32

REACH = 8
"""Texels of the coarsest level that a strip needs around it: for the pyramid, and for power measured over five."""


def halo(octaves: int) -> int:
    """Texels around a strip, a multiple of the coarsest level's texel."""
    return REACH * int(2**octaves)


def down(image: Float32) -> Float32:
    """(h / 2, w / 2, ...) means of 2 x 2 texels; h and w even."""
    import cv2

    size = (image.shape[1] // 2, image.shape[0] // 2)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)


def up(image: Float32, shape: tuple[int, int]) -> Float32:
    """Bicubic interpolation to (h, w) texels, twice as many."""
    import cv2

    return np.asarray(cv2.resize(image, shape[::-1], interpolation=cv2.INTER_CUBIC), np.float32)


def split(image: Float32, octaves: int) -> tuple[list[Float32], Float32]:
    """Octaves of an image (h, w) or (h, w, C), finest first, each at its own level's size; and the rest.

    Both sides have to be multiples of ``2^octaves``.
    """
    bands, rest = [], image
    for _ in range(octaves):
        smaller = down(rest)
        bands.append(rest - up(smaller, rest.shape[:2]))
        rest = smaller
    return bands, rest


def joined(bands: Sequence[Float32], rest: Float32 | None = None) -> Float32:
    """The image of octaves, inverse of :func:`split`; a ``rest`` of None counts as 0."""
    result = rest
    for band in reversed(bands):
        result = band.copy() if result is None else band + up(result, band.shape[:2])
    assert result is not None  # noqa: S101 - there is at least one octave
    return result
