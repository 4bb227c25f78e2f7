"""The reader's parts at any pixels of the photo, out of the two crops that it read."""

from __future__ import annotations

import numpy as np

from service.arrays import Float32, Float64
from service.face.reading.parts import BACKGROUND, HAIR
from service.face.reading.reader import PART_CELLS, Reading

SEAM_CELLS = 6.0
"""Cells of the narrow crop over which its answer goes over into that of the wider one, at its border."""
LONGEST = 30_000
"""Rows that OpenCV remaps at a time: it counts them in 16 bits."""


def parts_at_pixels(reading: Reading, at: Float64, *, strands: bool = False) -> Float32:
    """(N, 13) float32 probabilities of the parts at photo pixels (N, 2); what no crop shows counts as background.

    The narrow crop, which is finer, goes over into the wider one at its border.

    Args:
        reading: of the photo.
        at: photo pixels.
        strands: hair is where either crop shows it, for those who would rather miss skin than take hair for it: of
            hair before the skin of portraits the narrow crop misses 3.5 %, both 2.4 %.
    """
    narrow, inside = _in_crop(reading, at)
    if reading.around is None:
        return _beyond(narrow, inside)
    wide, around = _in_crop(reading.around, at)
    wide = _beyond(wide, around)
    share = np.clip(inside / SEAM_CELLS, 0, 1)[:, None]
    parts = np.asarray(share * narrow + (1 - share) * wide, np.float32)
    return _with_hair(parts, wide[:, HAIR]) if strands else parts


def _with_hair(parts: Float32, other: Float32) -> Float32:
    """Probabilities (N, 13) in which hair has at least another's (N,), at the cost of all else alike."""
    hair = np.maximum(parts[:, HAIR], other)
    left = (1 - hair) / np.maximum(1 - parts[:, HAIR], np.float32(1e-6))
    parts = parts * np.minimum(left, 1)[:, None]
    parts[:, HAIR] = hair
    return parts


def _in_crop(reading: Reading, at: Float64) -> tuple[Float32, Float32]:
    """(N, 13) a crop's probabilities, and (N,) how many cells the points lie within its border, < 0 beyond."""
    import cv2

    cells = reading.region.to_crop(at, PART_CELLS).astype(np.float32)
    result = np.zeros((len(at), reading.parts.shape[-1]), np.float32)
    for first in range(0, len(at), LONGEST):
        rows = slice(first, first + LONGEST)
        x, y = (cells[rows, None, k] - np.float32(0.5) for k in (0, 1))
        for start in range(0, result.shape[1], 4):  # OpenCV takes four channels
            planes = np.ascontiguousarray(reading.parts[..., start : start + 4])
            found = cv2.remap(planes, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            result[rows, start : start + 4] = np.asarray(found).reshape(len(x), -1)
    return result, np.minimum(cells, PART_CELLS - cells).min(1)


def _beyond(parts: Float32, inside: Float32) -> Float32:
    parts[inside < 0] = np.eye(parts.shape[1], dtype=np.float32)[BACKGROUND]
    return parts
