"""From the colour space of a profile, or a stated gamma, to sRGB."""

from __future__ import annotations

from io import BytesIO

from PIL import Image, ImageCms

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
    table = [round(255 * _srgb((value / 255) ** (1 / gamma))) for value in range(256)]
    return image.point(table * len(image.getbands()))


def _srgb(light: float) -> float:
    return 12.92 * light if light <= 0.0031308 else 1.055 * light ** (1 / 2.4) - 0.055
