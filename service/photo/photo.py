"""What the decode gate hands on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Photo:
    """A clean, upright photo.

    Attributes:
        pixels: (H, W, 3) uint8, sRGB, row 0 = top, EXIF turn applied.
        focal_35mm: 35 mm equivalent focal length from EXIF in mm, or None where unknown.
        sha256: hex digest of the bytes that came in.
        warnings: stable codes (``no-colour``, ``transparent``, ``icc-ignored`` ...), each also in the manifest.
        steps: (8, 8) float32 quantisation steps of a JPEG file's luma in coded values (1 = white), row = vertical
            frequency of the upright photo's file; None for other formats.
    """

    pixels: npt.NDArray[np.uint8]
    focal_35mm: float | None = None
    sha256: str = ""
    warnings: tuple[str, ...] = ()
    steps: npt.NDArray[np.float32] | None = None

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.pixels.shape[1], self.pixels.shape[0]
