"""Colours, tiles and text of the preview pictures."""

from __future__ import annotations

from typing import Any

import numpy as np

from service.arrays import AnyFloat, Float32, UInt8

Image = UInt8
Colour = tuple[int, int, int]

PAPER: Colour = (250, 250, 248)
TILE: Colour = (234, 235, 236)
INK: Colour = (38, 42, 48)
GREY: Colour = (118, 122, 128)
WARNING: Colour = (176, 72, 20)

_WITHOUT_FONT = str.maketrans({"°": "", "·": "-", "–": "-", "²": "2"})


def blank(width: int, height: int, colour: Colour = PAPER) -> Image:
    """(height, width, 3) uint8 sRGB of one colour."""
    return np.full((height, width, 3), colour, np.uint8)


def backdrop(width: int, height: int) -> Float32:
    """(height, width, 3) float32 sRGB in [0, 1]: the tile colour, brighter behind the head."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    away = ((x - width / 2) / (0.7 * width)) ** 2 + ((y - 0.42 * height) / (0.7 * height)) ** 2
    glow = np.float32(0.05) * np.exp(-2 * away)[..., None]
    return np.asarray(np.array(TILE, np.float32) / 255 * 0.98 + glow, np.float32)


def paste(page: Image, picture: Image, x: int, y: int) -> None:
    """Copy ``picture`` into ``page`` with its top left corner at (x, y); it has to lie within the page."""
    height, width = picture.shape[:2]
    page[y : y + height, x : x + width] = picture


def write_text(page: Image, text: str, x: int, y: int, size: int, colour: Colour = INK, *, bold: bool = False) -> None:
    """Write one line of ``text`` into ``page``, its baseline starting at (x, y), ``size`` pixels high.

    OpenCV 5 has a typeface; before it there are only stroke fonts, without a degree sign.
    """
    import cv2

    library: Any = cv2
    if hasattr(library, "FontFace"):
        library.putText(page, text, (x, y), colour, library.FontFace("sans"), size, 600 if bold else 400)
        return
    plain = text.translate(_WITHOUT_FONT).encode("ascii", "replace").decode()
    library.putText(page, plain, (x, y), library.FONT_HERSHEY_SIMPLEX, size / 32, colour, 1 + bold, library.LINE_AA)


def to_pixels(picture: AnyFloat) -> Image:
    """Coded values in [0, 1] -> uint8."""
    return np.asarray(np.rint(np.clip(picture, 0.0, 1.0) * 255), np.uint8)
