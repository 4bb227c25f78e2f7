"""What the decode gate hands on: a clean, upright photo, and whether it lacks colour.

An albedo can be read off colours only where there are any, so the fit wants to know. The pixels stay as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.colour import linear_to_lab, srgb_to_linear
from service.words import WarningCode


@dataclass(frozen=True)
class Photo:
    """A clean, upright photo.

    Attributes:
        pixels: (H, W, 3) uint8, sRGB, row 0 = top, EXIF turn applied.
        focal_35mm: 35 mm equivalent focal length from EXIF in mm, or None where unknown.
        sha256: hex digest of the bytes that came in.
        warnings: each also in the manifest.
        steps: (8, 8) float32 quantisation steps of a JPEG file's luma in coded values (1 = white), row = vertical
            frequency of the upright photo's file; None for other formats.
    """

    pixels: npt.NDArray[np.uint8]
    focal_35mm: float | None = None
    sha256: str = ""
    warnings: tuple[WarningCode, ...] = ()
    steps: npt.NDArray[np.float32] | None = None

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.pixels.shape[1], self.pixels.shape[0]


_SAMPLES = 160
_MEAN_CHROMA = 3.0
_HIGH_CHROMA = 8.0
_COLOURED = 4.0
_TINT_RESIDUAL = 5.0
"""Between 4.9, the largest of sepia versions of portraits after JPEG, and 7.6, the smallest of portraits in colour."""


def lacks_colour(pixels: npt.NDArray[np.uint8]) -> bool:
    """Whether colour is absent from (H, W, 3) uint8 sRGB pixels or says no more than lightness does.

    Grey: mean |a*| and |b*| both below 3, and the 99th percentile of chroma below 8, so that a small colourful face
    before a white wall counts as colour. Tinted (sepia): a* and b* are smooth functions of L*, see ``_tint_residual``.
    """
    lightness, a, b = linear_to_lab(srgb_to_linear(_sample(pixels))).T
    chroma = np.hypot(a, b)
    if max(np.abs(a).mean(), np.abs(b).mean()) < _MEAN_CHROMA and np.percentile(chroma, 99) < _HIGH_CHROMA:
        return True
    return _tint_residual(lightness, np.stack([a, b], axis=1), chroma > _COLOURED) < _TINT_RESIDUAL


def _tint_residual(
    lightness: npt.NDArray[np.float32], ab: npt.NDArray[np.float32], coloured: npt.NDArray[np.bool_]
) -> float:
    """95th percentile, over the coloured samples, of the distance of (a*, b*) from a cubic in L*.

    Coloured and neutral samples weigh the same in the fit: a print of one tint has neutral samples only at its black
    and white ends, where they fit the same curve, while a coloured thing before a grey wall has them at its own L*.
    """
    shares = np.where(coloured, coloured.mean(), (~coloured).mean())
    weights = np.sqrt(1 / shares)[:, None]
    basis = np.vander(lightness / 100, 4)
    solution = np.linalg.lstsq(weights * basis, weights * ab, rcond=None)[0]
    residual = np.hypot(*(ab - basis @ solution)[coloured].T)
    return float(np.percentile(residual, 95)) if residual.size else 0.0


def _sample(pixels: npt.NDArray[np.uint8]) -> npt.NDArray[np.float64]:
    """(N, 3) means of small blocks spread evenly over the image, in [0, 1]; a mean quiets JPEG's colour noise."""
    step_y, step_x = (max(1, -(-side // _SAMPLES)) for side in pixels.shape[:2])
    block = min(4, step_y, step_x)
    height, width = pixels.shape[0] - block + 1, pixels.shape[1] - block + 1
    total: npt.NDArray[np.float64] = np.zeros((len(range(0, height, step_y)), len(range(0, width, step_x)), 3))
    for dy in range(block):
        for dx in range(block):
            total += pixels[dy : dy + height : step_y, dx : dx + width : step_x]
    total /= 255 * block * block
    return total.reshape(-1, 3)
