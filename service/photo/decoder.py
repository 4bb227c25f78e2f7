"""Image file to upright 8-bit sRGB; runs in the decoding process only.

The format classes of Pillow are called directly: no plugin search, so no format but the one that the gate named can
be reached, and no helper program (Pillow runs Ghostscript for PostScript).
"""

from __future__ import annotations

import math
import signal
import struct
import sys
import warnings
import zlib
from collections.abc import Callable
from importlib import import_module
from io import BytesIO
from typing import Any, BinaryIO, NamedTuple

from PIL import ExifTags, Image, ImageChops, ImageCms, ImageFile, PngImagePlugin
from PIL import TiffImagePlugin as _TiffImagePlugin  # noqa: F401 - else read with the first EXIF, where no file can be

from service.photo.wire import (
    FOCAL_RANGE_MM,
    READY,
    REPLY_SIZE,
    Codec,
    Note,
    Output,
    Reply,
    Request,
    Status,
    lower_limits,
)

MAX_ICC_BYTES = 4 * 1024**2
"""Largest colour profile that is looked at; printer profiles with tables stay below 3 MB."""

BACKGROUND = 128
"""Grey that shows through transparent pixels; sRGB value."""

_TURNS = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}
# All that Pillow's readers raise for bytes that they cannot decode. MemoryError is not among them.
_DECODER_FAULTS = (
    OSError,
    SyntaxError,
    ValueError,
    TypeError,
    LookupError,
    EOFError,
    ArithmeticError,
    RuntimeError,
    Warning,
    struct.error,
    zlib.error,
    Image.DecompressionBombError,
)

_READERS = {
    Codec.JPEG: ("PIL.JpegImagePlugin", "JpegImageFile"),
    Codec.PNG: ("PIL.PngImagePlugin", "PngImageFile"),
    Codec.WebP: ("PIL.WebPImagePlugin", "WebPImageFile"),
    Codec.HEIC: ("pillow_heif", "HeifImageFile"),
}

Opener = Callable[[bytes], ImageFile.ImageFile]


class Refusal(Exception):
    """The bytes are no photo that is taken; ``args[0]`` is the reply that says why."""


class Decoded(NamedTuple):
    """An image, what was noticed, its 35 mm equivalent focal length in mm (0: unknown), and the steps of a JPEG."""

    image: Image.Image
    notes: Note = Note(0)
    focal_35mm: float = 0.0
    steps: tuple[int, ...] = (0,) * 64


def prepare(codec: Codec) -> Opener:
    """Import the reader of one format.

    The process gives up its right to open files before it looks at a photo, so nothing can be imported later.
    """
    module, name = _READERS[codec]
    plugin: Any = import_module(module)
    if codec == Codec.PNG:
        plugin.MAX_TEXT_CHUNK = MAX_ICC_BYTES  # bounds profiles too
    if codec == Codec.HEIC:
        # Each thread would take address space for its stack and its heap.
        plugin.options.DECODE_THREADS = 1
        plugin.options.THUMBNAILS = plugin.options.DEPTH_IMAGES = plugin.options.AUX_IMAGES = False
    reader: Callable[[BytesIO], ImageFile.ImageFile] = getattr(plugin, name)
    return lambda data: reader(BytesIO(data))


def decode(open_image: Opener, request: Request) -> Decoded:
    """Decode one file with the opener from ``prepare``.

    Refusal: damaged, of another size than its header states, a sequence of frames, or over the limits. MemoryError:
    more memory than the process may have.
    """
    opened, image = _load(open_image, request)
    info = opened.info
    if request.output != Output.PHOTO:
        colours, alpha = _split_alpha(image)
        bands = colours.convert("RGB").split()
        if request.output == Output.CODES_AND_ALPHA:
            return Decoded(Image.merge("RGBA", (*bands, Image.new("L", image.size, 255) if alpha is None else alpha)))
        return Decoded(Image.merge("RGB", bands))
    notes = Note.EXTRA_IMAGES if getattr(opened, "n_frames", 1) > 1 or "mp" in info else Note(0)
    steps = next(iter(getattr(opened, "quantization", {}).values()), (0,) * 64)
    image, focal, exif_note = _by_exif(image, info.get("exif"), turned=request.codec == Codec.HEIC)
    image, alpha = _split_alpha(image)
    image, icc_note = _to_srgb(image, info)
    notes |= exif_note | icc_note
    if alpha is not None and alpha.getextrema()[0] != 255:
        notes |= Note.TRANSPARENT
        background = Image.new("RGB", image.size, (BACKGROUND,) * 3)
        background.paste(image, mask=alpha)
        image = background
    return Decoded(image, notes, focal, tuple(steps))


def _by_exif(image: Image.Image, exif: object, *, turned: bool) -> tuple[Image.Image, float, Note]:
    """The image upright, unless the reader has turned it, its focal length, and a note where that is of another one."""
    if not isinstance(exif, bytes):
        return image, 0.0, Note(0)
    facts = read_exif(exif.removeprefix(b"Exif\0\0")[:MAX_EXIF_BYTES])
    if not turned and facts.orientation in _TURNS:
        image = image.transpose(_TURNS[facts.orientation])
    if facts.focal_35mm is None:
        return image, 0.0, Note(0)
    cropped = facts.cropped(image.size)
    return image, 0.0 if cropped else facts.focal_35mm, Note.FOCAL_IGNORED if cropped else Note(0)


def _load(open_image: Opener, request: Request) -> tuple[ImageFile.ImageFile, Image.Image]:
    """Open, check the size once more, decode; returns the file and its pixels."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        try:
            image = open_image(request.payload)
            width, height = image.size
            if max(width, height) > request.max_side or width * height > request.max_pixels:
                raise Refusal(Reply(Status.BAD_SIZE, width=width, height=height))
            if request.width and (width, height) != (request.width, request.height):
                raise ValueError("another size than the header states")
            frames = getattr(image, "n_frames", 1)
            if frames > 1 and image.format != "HEIF":
                raise Refusal(Reply(Status.ANIMATED, width=frames))
            return image, _load_pixels(image, request.payload)
        except _DECODER_FAULTS as fault:
            raise Refusal(Reply(Status.CORRUPT)) from fault


def _load_pixels(image: ImageFile.ImageFile, payload: bytes) -> Image.Image:
    depth = payload[24] if image.format == "PNG" else 8
    if depth == 16:
        return decode_png16(image, payload)
    image.load()
    key = image.info.get("transparency")
    if depth < 8 and image.mode == "L" and isinstance(key, int):
        # The key is stated at the depth of the file; Pillow has spread the samples to 8 bits.
        image.info["transparency"] = key * 255 // (2**depth - 1)
    return image


def _split_alpha(image: Image.Image) -> tuple[Image.Image, Image.Image | None]:
    """Colour in mode L, RGB or CMYK, and alpha in mode L where there is any."""
    if "transparency" in image.info or image.mode in ("PA", "RGBa", "La"):
        image = image.convert("RGBA")
    if image.mode in ("RGBA", "LA"):
        *bands, alpha = image.split()
        return (bands[0] if len(bands) == 1 else Image.merge("RGB", bands)), alpha
    if image.mode == "1":
        return image.convert("L"), None
    if image.mode in ("L", "RGB", "CMYK"):
        return image, None
    return image.convert("RGB"), None


def _to_srgb(image: Image.Image, info: dict[str | tuple[int, int], Any]) -> tuple[Image.Image, Note]:
    """The image in sRGB by what its file says of its colours: a profile, which may be broken, or an exponent."""
    note, icc, gamma = Note(0), info.get("icc_profile"), info.get("gamma", 0.0)
    if icc:
        converted = profile_to_srgb(image, icc) if len(icc) <= MAX_ICC_BYTES else None
        if converted is not None:
            return converted, note
    if icc or "icc_profile" in info:
        note = Note.ICC_IGNORED
    # Writers state the exponent of sRGB as 1/2.2; what does not visibly differ from it is that.
    elif "srgb" not in info and 0.1 <= gamma <= 10 and not math.isclose(gamma, 1 / 2.2, rel_tol=0.05):
        image = gamma_to_srgb(image, gamma)
    return (image if image.mode == "RGB" else image.convert("RGB")), note


MAX_EXIF_BYTES = 1 << 16
"""As much EXIF as is looked at, and as a JPEG segment can hold; the directories come first, then thumbnails."""

_SPACES = {"RGB ": ("RGB", "RGBX"), "GRAY": ("L", "1"), "CMYK": ("CMYK",)}
# Black-point compensation: a printer's black becomes black rather than dark grey.
_FLAGS = ImageCms.Flags.BLACKPOINTCOMPENSATION


def profile_to_srgb(image: Image.Image, icc: bytes) -> Image.Image | None:
    """Convert an image by its ICC profile (ICC.1:2022), with the relative colorimetric intent.

    The image is of mode L, RGB or CMYK, its values in the space of the profile. None where the profile is broken or is
    for another kind of image, else the image in sRGB, mode RGB.
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
    """Re-encode samples (L or RGB), light ** ``gamma`` > 0 (1 is linear), with the sRGB curve (IEC 61966-2-1)."""
    table = [round(255 * _srgb_code((value / 255) ** (1 / gamma))) for value in range(256)]
    return image.point(table * len(image.getbands()))


def _srgb_code(light: float) -> float:
    return 12.92 * light if light <= 0.0031308 else 1.055 * light ** (1 / 2.4) - 0.055


_CARRY = [int(difference >= 129) for difference in range(256)]


def decode_png16(image: ImageFile.ImageFile, payload: bytes) -> Image.Image:
    """Decode a PNG of 16 bits a sample, opened and not yet loaded, to 8 bits; its bytes are opened a second time.

    The result has mode L, LA, RGB or RGBA; a colour key in the file becomes alpha, compared at 16 bits.
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

    These are TIFF-structured, possibly broken or empty, and at most ``MAX_EXIF_BYTES``, since what Pillow spends grows
    with them.
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


_STRIP_ROWS = 256


def main() -> int:
    """Decode one photo; returns the exit status of the process."""
    sys.stdout.buffer.write(READY)
    sys.stdout.buffer.flush()
    request = Request.parse(sys.stdin.buffer.read())
    _limit_spending(request)
    open_image = prepare(request.codec)
    _give_up_files()
    answer(request, open_image, sys.stdout.buffer)
    return 0


def answer(request: Request, open_image: Opener, out: BinaryIO) -> None:
    """Decode and write the reply, with the pixels in row order."""
    try:
        decoded = decode(open_image, request)
    except Refusal as refusal:
        out.write(refusal.args[0].pack())
    except MemoryError:
        out.write(Reply(Status.TOO_COMPLEX).pack())
    else:
        _write_pixels(decoded, out)
    out.flush()


def _write_pixels(decoded: Decoded, out: BinaryIO) -> None:
    image = decoded.image
    out.write(Reply(Status.DONE, decoded.notes, image.width, image.height, decoded.focal_35mm, decoded.steps).pack())
    for top in range(0, image.height, _STRIP_ROWS):
        bottom = min(top + _STRIP_ROWS, image.height)
        out.write(image.crop((0, top, image.width, bottom)).tobytes())


def _limit_spending(request: Request) -> None:
    """Memory, time, bytes written, and an own alarm clock, in case that nobody is left to kill this process."""
    signal.alarm(math.ceil(request.wall_seconds) + 1)
    largest = len(READY) + REPLY_SIZE + request.max_pixels * request.output.channels
    lower_limits(CPU=request.cpu_seconds, CORE=0, FSIZE=largest, AS=request.memory_bytes)


def _give_up_files() -> None:
    """No new descriptor, no program loaded."""
    # A descriptor limit below the next free number refuses open, socket and pipe, and with them the loader of any
    # program that would be started.
    lower_limits(NOFILE=0, NPROC=0)
