"""What a walk over an image file finds, before any of its pixels are decoded.

The walkers (``jpeg``, ``png``, ``webp``) are plain Python over bounded slices, so they cannot be made to write where
they should not; they run in linear time and allocate no more than the file. They hand on a file with everything
taken out that is not needed for the pixels: the native decoder sees no EXIF, no text, no second image.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

MAX_ICC_BYTES = 4 * 1024**2
"""Largest colour profile that is looked at; printer profiles with tables stay below 3 MB."""

MAX_EXIF_BYTES = 1 << 16
"""As much EXIF as is looked at, and as a JPEG can hold; the directories come first, what is cut off is thumbnails."""


class Codec(IntEnum):
    """The formats that are decoded; an allow-list."""

    JPEG = 1
    PNG = 2
    WEBP = 3
    HEIC = 4


class Container(NamedTuple):
    """One still image, with its metadata taken apart.

    Attributes:
        codec: which decoder to use.
        size: (width, height) in pixels as stored, before any EXIF turn; None where only the decoder can tell.
        payload: a file that holds the pixels of the first image and nothing else.
        exif: TIFF-structured EXIF bytes, or empty.
        icc: colour profile, or empty.
        gamma: encoding exponent of a PNG that states one and has no profile (image = light ** gamma), or 0.
        warnings: stable codes of what was found and left out.
    """

    codec: Codec
    size: tuple[int, int] | None
    payload: bytes
    exif: bytes = b""
    icc: bytes = b""
    gamma: float = 0.0
    warnings: tuple[str, ...] = ()
