"""What Pillow lacks, for the decoding process: colour profiles to sRGB, 16-bit PNG, and the two EXIF facts."""

from __future__ import annotations

import warnings
from io import BytesIO
from typing import Any, NamedTuple

from PIL import ExifTags, Image, ImageChops, ImageCms, ImageFile, PngImagePlugin
from PIL import TiffImagePlugin as _TiffImagePlugin  # noqa: F401

from service.photo.wire import FOCAL_RANGE_MM

MAX_EXIF_BYTES = 1 << 16
"""As much EXIF as is looked at, and as a JPEG segment can hold; the directories come first, then thumbnails."""

_SPACES = {"RGB ": ("RGB", "RGBX"), "GRAY": ("L", "1"), "CMYK": ("CMYK",)}
# Black-point compensation: a printer's black becomes black rather than dark grey.
_FLAGS = ImageCms.Flags.BLACKPOINTCOMPENSATION


def profile_to_srgb(image: Image.Image, icc: bytes) -> Image.Image | None:
    """Convert an image by its ICC profile (ICC.1:2022), with the relative colorimetric intent.

    Args:
        image: mode L, RGB or CMYK, values in the space of the profile.
        icc: the profile.

    Returns:
        The image in sRGB, mode RGB; None where the profile is broken or is for another kind of image.
    """
    try:
        profile = ImageCms.ImageCmsProfile(BytesIO(icc))
        space = profile.profile.xcolor_space
        if space == "RGB " and image.mode == "L":
            image = image.convert("RGB")
        if image.mode not in _SPACES.get(space, ()):
            return None
        transform = ImageCms.buildTransform(
            profile, ImageCms.createProfile("sRGB"), image.mode, "RGB", ImageCms.Intent.RELATIVE_COLORIMETRIC, _FLAGS
        )
        return ImageCms.applyTransform(image, transform)
    except (ImageCms.PyCMSError, OSError, ValueError, TypeError):
        return None


def gamma_to_srgb(image: Image.Image, gamma: float) -> Image.Image:
    """Re-encode samples that are light ** ``gamma`` with the sRGB curve (IEC 61966-2-1).

    Args:
        image: mode L or RGB.
        gamma: exponent, over 0; 1 means linear.
    """
    table = [round(255 * _srgb_code((value / 255) ** (1 / gamma))) for value in range(256)]
    return image.point(table * len(image.getbands()))


def _srgb_code(light: float) -> float:
    return 12.92 * light if light <= 0.0031308 else 1.055 * light ** (1 / 2.4) - 0.055


_CARRY = [int(difference >= 129) for difference in range(256)]


def decode_png16(image: ImageFile.ImageFile, payload: bytes) -> Image.Image:
    """Decode a PNG of 16 bits a sample to 8 bits.

    Args:
        image: the opened, not yet loaded file.
        payload: its bytes, from which it is opened a second time.

    Returns:
        An image of mode L, LA, RGB or RGBA; a colour key in the file becomes alpha, compared at 16 bits.
    """
    high, low = _bytes(image, payload)
    bands = [_round(*pair) for pair in zip(high, low, strict=True)]
    key = image.info.get("transparency")
    if key is not None:
        keys = key if isinstance(key, tuple) else (key,)
        bands.append(_opaque(high, low, keys))
    mode = {1: "L", 2: "LA", 3: "RGB", 4: "RGBA"}[len(bands)]
    return Image.merge(mode, bands)


def _bytes(image: ImageFile.ImageFile, payload: bytes) -> tuple[list[Image.Image], list[Image.Image]]:
    """High and low bytes of each channel, as images of mode L."""
    layout = str(image.tile[0].args)
    if layout == "I;16B":
        # Loaded samples lie in memory as low byte, high byte.
        low, high = Image.frombuffer("LA", image.size, image.tobytes(), "raw", "LA", 0, 1).split()
        return [high], [low]
    if layout == "LA;16B":
        # Four bytes a pixel, so the four channels of RGBA take them one by one.
        image.tile = [tile._replace(args="RGBA") for tile in image.tile]
        grey_high, grey_low, alpha_high, alpha_low = image.split()
        return [grey_high, alpha_high], [grey_low, alpha_low]
    again = PngImagePlugin.PngImageFile(BytesIO(payload))
    again.tile = [tile._replace(args=layout.replace("16B", "16L")) for tile in again.tile]
    return list(image.split()), list(again.split())


def _round(high: Image.Image, low: Image.Image) -> Image.Image:
    up = ImageChops.subtract(low, high).point(_CARRY)
    down = ImageChops.subtract(high, low).point(_CARRY)
    return ImageChops.subtract(ImageChops.add(high, up), down)


def _opaque(high: list[Image.Image], low: list[Image.Image], keys: tuple[int, ...]) -> Image.Image:
    """255 where any channel differs from its key, else 0."""
    opaque = Image.new("L", high[0].size, 0)
    for upper, lower, key in zip(high, low, keys, strict=True):
        for band, byte in ((upper, key >> 8), (lower, key & 255)):
            differs = band.point([0 if value == byte else 255 for value in range(256)])
            opaque = ImageChops.lighter(opaque, differs)
    return opaque


# Pillow imports it when it reads the first directory, which is too late: the decoding process can then open no file.


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
        exif: TIFF-structured bytes, possibly broken or empty; ``MAX_EXIF_BYTES`` of them at most, since what
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
