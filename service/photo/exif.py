"""The two EXIF facts that the fit needs; everything else in EXIF is never read and never passed on.

EXIF is a TIFF directory (Exif 3.0, section 4.6). This reader follows at most two directories and copies nothing, so
broken, looping or huge EXIF costs nothing and yields the defaults.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

MAX_ENTRIES = 2048
FOCAL_RANGE_MM = (8.0, 1200.0)
"""35 mm equivalents that exist as lenses; others, and the 0 that stands for unknown, are not believed."""

_ORIENTATION, _EXIF_DIRECTORY, _FOCAL_35MM, _PIXEL_X, _PIXEL_Y = 0x0112, 0x8769, 0xA405, 0xA002, 0xA003
_CROP_TOLERANCE = 0.02


class ExifFacts(NamedTuple):
    """What EXIF says about the picture.

    Attributes:
        orientation: 1 to 8 as in EXIF tag 0x0112; 1 where it is missing or invalid.
        focal_35mm: 35 mm equivalent focal length in mm, or None where it is missing or not plausible.
        cropped: whether the sides that EXIF states differ in proportion from those of the image, so that the focal
            length belongs to another frame.
    """

    orientation: int = 1
    focal_35mm: float | None = None
    cropped: bool = False


def read_exif(exif: bytes, size: tuple[int, int]) -> ExifFacts:
    """Read orientation and focal length; never raises.

    Args:
        exif: TIFF-structured bytes, possibly broken or empty.
        size: (width, height) of the stored image, in pixels.
    """
    order: Literal["big", "little"] = "big" if exif[:2] == b"MM" else "little"
    if exif[:4] not in (b"II*\0", b"MM\0*"):
        return ExifFacts()
    main = _directory(exif, int.from_bytes(exif[4:8], order), order)
    orientation = main.get(_ORIENTATION, 1)
    if orientation not in range(1, 9):
        orientation = 1
    sub = _directory(exif, main[_EXIF_DIRECTORY], order) if _EXIF_DIRECTORY in main else {}
    focal = float(sub.get(_FOCAL_35MM, 0))
    if not FOCAL_RANGE_MM[0] <= focal <= FOCAL_RANGE_MM[1]:
        return ExifFacts(orientation)
    if _is_cropped((sub.get(_PIXEL_X, 0), sub.get(_PIXEL_Y, 0)), size):
        return ExifFacts(orientation, None, cropped=True)
    return ExifFacts(orientation, focal)


def _is_cropped(stated: tuple[int, int], size: tuple[int, int]) -> bool:
    # Long side over short side: some cameras state the sides of the turned picture.
    if min(stated) <= 0 or min(size) <= 0:
        return False
    before, after = max(stated) / min(stated), max(size) / min(size)
    return abs(before - after) > _CROP_TOLERANCE * before


def _directory(exif: bytes, start: int, order: Literal["big", "little"]) -> dict[int, int]:
    """Tags of one directory that hold a single 16 or 32-bit whole number."""
    tags: dict[int, int] = {}
    count = min(int.from_bytes(exif[start : start + 2], order), MAX_ENTRIES)
    for index in range(count):
        entry = exif[start + 2 + 12 * index : start + 14 + 12 * index]
        if len(entry) < 12:
            break
        tag, kind, number = (int.from_bytes(entry[a:b], order) for a, b in ((0, 2), (2, 4), (4, 8)))
        if number == 1 and kind in (3, 4):
            tags.setdefault(tag, int.from_bytes(entry[8 : 10 if kind == 3 else 12], order))
    return tags
