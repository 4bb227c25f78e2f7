"""The two EXIF facts that the fit needs, read by Pillow in the decoding process; nothing else goes further.

EXIF is a TIFF directory (Exif 3.0, section 4.6). Whatever Pillow makes of broken EXIF, the answer is the defaults: a
photo is not refused for it.
"""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

from PIL import ExifTags, Image

# Pillow imports it when it reads the first directory, which is too late: the decoding process can then open no file.
from PIL import TiffImagePlugin as _TiffImagePlugin  # noqa: F401

from service.photo.wire import FOCAL_RANGE_MM

_CROP_TOLERANCE = 0.02
"""Share by which stated proportions may differ from those of the image: sides are rounded to whole pixels."""


class ExifFacts(NamedTuple):
    """What EXIF says about the picture.

    Attributes:
        orientation: 1 to 8 as in EXIF tag 0x0112; 1 where it is missing or invalid.
        focal_35mm: 35 mm equivalent focal length in mm, or None where it is missing or not plausible.
        sides: (width, height) in pixels that the camera stored, in either order; 0 where unknown.
    """

    orientation: int = 1
    focal_35mm: float | None = None
    sides: tuple[int, int] = (0, 0)

    def cropped(self, size: tuple[int, int]) -> bool:
        """Whether an image of ``size`` has other proportions than the camera's, so that the focal length is not its."""
        # Long side over short side: some cameras state the sides of the turned picture.
        if min(self.sides) <= 0 or min(size) <= 0:
            return False
        before, after = max(self.sides) / min(self.sides), max(size) / min(size)
        return abs(before - after) > _CROP_TOLERANCE * before


def read_exif(exif: bytes) -> ExifFacts:
    """Read orientation, focal length and the camera's sides; never raises for what the bytes are.

    Args:
        exif: TIFF-structured bytes, possibly broken or empty; ``container.MAX_EXIF_BYTES`` of them at most, since what
            Pillow spends grows with them.
    """
    tags = Image.Exif()
    orientation = 0
    camera: dict[int, Any] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            tags.load(exif)
            orientation = _whole(tags.get(ExifTags.Base.Orientation))
            camera = tags.get_ifd(ExifTags.IFD.Exif)
        except Exception:  # noqa: S110 - its readers of values raise what they come across; the defaults hold
            pass
    focal = _whole(camera.get(ExifTags.Base.FocalLengthIn35mmFilm))
    return ExifFacts(
        orientation if 1 <= orientation <= 8 else 1,
        float(focal) if FOCAL_RANGE_MM[0] <= focal <= FOCAL_RANGE_MM[1] else None,
        (_whole(camera.get(ExifTags.Base.ExifImageWidth)), _whole(camera.get(ExifTags.Base.ExifImageHeight))),
    )


def _whole(value: Any) -> int:
    """The value where it is one whole number, as the standard says of these tags; else 0."""
    return value if isinstance(value, int) else 0
