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
from typing import BinaryIO, NamedTuple

from PIL import Image, ImageFile

from service.photo.container import MAX_EXIF_BYTES, Codec
from service.photo.wire import READY, Note, Reply, Request, Status

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

Opener = Callable[[bytes], ImageFile.ImageFile]


class DecoderFault(Exception):
    """The bytes could not be decoded."""


class Animated(Exception):
    """The file holds a sequence; ``args[0]`` is the number of frames."""


class BadSize(Exception):
    """The size is over its limits; ``args`` are width and height."""


class Decoded(NamedTuple):
    """An upright RGB image in sRGB, what was noticed, and its 35 mm equivalent focal length in mm, 0 where unknown."""

    image: Image.Image
    notes: Note
    focal_35mm: float = 0.0


def prepare(codec: int, *, colour: bool, exif: bool) -> Opener:
    """Import the reader of one format and, with ``colour`` and ``exif``, the colour engine and the reader of EXIF.

    The process gives up its right to open files before it looks at a photo, so nothing can be imported later.
    """
    if colour or codec == Codec.HEIC:
        import_module("service.photo.conversions")
    if exif or codec == Codec.HEIC:
        import_module("service.photo.conversions")
    if codec == Codec.JPEG:
        from PIL.JpegImagePlugin import JpegImageFile

        return lambda data: JpegImageFile(BytesIO(data))
    if codec == Codec.PNG:
        from PIL.PngImagePlugin import PngImageFile

        import_module("service.photo.conversions")
        return lambda data: PngImageFile(BytesIO(data))
    if codec == Codec.WEBP:
        from PIL.WebPImagePlugin import WebPImageFile

        return lambda data: WebPImageFile(BytesIO(data))
    if codec == Codec.HEIC:
        from pillow_heif import HeifImageFile, options

        # Each thread would take address space for its stack and its heap.
        options.DECODE_THREADS = 1
        options.THUMBNAILS = options.DEPTH_IMAGES = options.AUX_IMAGES = False
        reader: Callable[[BytesIO], ImageFile.ImageFile] = HeifImageFile
        return lambda data: reader(BytesIO(data))
    raise ValueError(f"no such codec: {codec}")


def decode(
    open_image: Opener, payload: bytes, icc: bytes, gamma: float, exif: bytes, max_side: int, max_pixels: int,
    alpha_only: bool = False,
) -> Decoded:  # fmt: skip
    """Decode one file.

    Args:
        open_image: from ``prepare``.
        payload: the image file.
        icc: colour profile; where empty, the one that the decoder finds is used (HEIC).
        gamma: exponent of the encoding, or 0 for sRGB.
        exif: EXIF that the file stores, or empty. Where the decoder finds it itself (HEIC), it has undone the turn too.
        max_side: longest side, in pixels.
        max_pixels: width times height.
        alpha_only: give the opacity as grey, 255 where there is none, in place of the colours.

    Raises:
        DecoderFault: damaged, or a mode that no photo has.
        Animated: more than one frame.
        BadSize: over the limits.
        MemoryError: more memory than the process may have.
    """
    image, found = _load(open_image, payload, max_side, max_pixels)
    icc = icc or image.info.get("icc_profile") or b""
    notes = Note(0)
    if getattr(image, "n_frames", 1) > 1:
        notes |= Note.EXTRA_IMAGES
    image, focal, exif_note = _by_exif(image, exif, found)
    notes |= exif_note
    image, alpha = _split_alpha(image)
    if alpha_only:
        opacity = Image.new("L", image.size, 255) if alpha is None else alpha
        return Decoded(Image.merge("RGB", [opacity] * 3), notes, focal)
    image, icc_note = _to_srgb(image, icc, gamma)
    notes |= icc_note
    if alpha is not None and alpha.getextrema()[0] != 255:
        notes |= Note.TRANSPARENT
        background = Image.new("RGB", image.size, (BACKGROUND,) * 3)
        background.paste(image, mask=alpha)
        image = background
    return Decoded(image, notes, focal)


def _by_exif(image: Image.Image, stored: bytes, found: bytes) -> tuple[Image.Image, float, Note]:
    """The image upright, its focal length and a note where that is of another frame."""
    if not stored and not found:
        return image, 0.0, Note(0)
    from service.photo.conversions import read_exif

    facts = read_exif(stored or found.removeprefix(b"Exif\0\0")[:MAX_EXIF_BYTES])
    if stored and facts.orientation in _TURNS:
        image = image.transpose(_TURNS[facts.orientation])
    if facts.focal_35mm is None:
        return image, 0.0, Note(0)
    cropped = facts.cropped(image.size)
    return image, 0.0 if cropped else facts.focal_35mm, Note.FOCAL_IGNORED if cropped else Note(0)


def _load(open_image: Opener, payload: bytes, max_side: int, max_pixels: int) -> tuple[Image.Image, bytes]:
    """Open, check the size once more, decode; returns the image and its EXIF where the decoder found it."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            image = open_image(payload)
            width, height = image.size
            if max(width, height) > max_side or width * height > max_pixels:
                raise BadSize(width, height)
            frames = getattr(image, "n_frames", 1)
            if frames > 1 and image.format != "HEIF":
                raise Animated(frames)
            exif = image.info.get("exif", b"")
            return _load_pixels(image, payload), exif if isinstance(exif, bytes) else b""
        except _DECODER_FAULTS as fault:
            raise DecoderFault(type(fault).__name__) from fault


def _load_pixels(image: ImageFile.ImageFile, payload: bytes) -> Image.Image:
    depth = payload[24] if image.format == "PNG" else 8
    if depth == 16:
        from service.photo.conversions import decode_png16

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


def _to_srgb(image: Image.Image, icc: bytes, gamma: float) -> tuple[Image.Image, Note]:
    note = Note(0)
    if icc:
        from service.photo.conversions import profile_to_srgb

        converted = profile_to_srgb(image, icc)
        if converted is not None:
            return converted, note
        note = Note.ICC_IGNORED
    elif gamma:
        from service.photo.conversions import gamma_to_srgb

        image = gamma_to_srgb(image, gamma)
    return (image if image.mode == "RGB" else image.convert("RGB")), note


_STRIP_ROWS = 256


def main() -> int:
    """Decode one photo; returns the exit status of the process."""
    sys.stdout.buffer.write(READY)
    sys.stdout.buffer.flush()
    request = Request.parse(sys.stdin.buffer.read())
    _limit_spending(request)
    open_image = prepare(request.codec, colour=bool(request.icc or request.gamma), exif=bool(request.exif))
    _give_up_files()
    answer(request, open_image, sys.stdout.buffer)
    return 0


def answer(request: Request, open_image: Opener, out: BinaryIO) -> None:
    """Decode and write the reply, with the pixels in row order, 3 bytes each."""
    try:
        decoded = decode(
            open_image,
            request.payload,
            request.icc,
            request.gamma,
            request.exif,
            request.max_side,
            request.max_pixels,
            request.alpha,
        )
    except BadSize as fault:
        out.write(Reply(Status.BAD_SIZE, width=fault.args[0], height=fault.args[1]).pack())
    except Animated as fault:
        out.write(Reply(Status.ANIMATED, width=fault.args[0]).pack())
    except DecoderFault:
        out.write(Reply(Status.CORRUPT).pack())
    except MemoryError:
        out.write(Reply(Status.TOO_COMPLEX).pack())
    else:
        _write_pixels(decoded, out)
    out.flush()


def _write_pixels(decoded: Decoded, out: BinaryIO) -> None:
    image = decoded.image
    out.write(Reply(Status.DONE, decoded.notes, image.width, image.height, decoded.focal_35mm).pack())
    for top in range(0, image.height, _STRIP_ROWS):
        bottom = min(top + _STRIP_ROWS, image.height)
        out.write(image.crop((0, top, image.width, bottom)).tobytes())


def _limit_spending(request: Request) -> None:
    """Memory, processor time and an own alarm clock, in case that nobody is left to kill this process."""
    if sys.platform == "win32":
        return
    import resource

    signal.alarm(math.ceil(request.wall_seconds) + 1)
    _lower(resource.RLIMIT_CPU, request.cpu_seconds)
    _lower(resource.RLIMIT_CORE, 0)
    if sys.platform == "linux":
        _lower(resource.RLIMIT_AS, request.memory_bytes)


def _give_up_files() -> None:
    """No new descriptor, no byte written to a file, no program loaded."""
    if sys.platform != "linux":
        return
    import resource

    # A descriptor limit below the next free number refuses open, socket and pipe, and with them the loader of any
    # program that would be started.
    _lower(resource.RLIMIT_NOFILE, 0)
    _lower(resource.RLIMIT_FSIZE, 0)
    _lower(resource.RLIMIT_NPROC, 0)


if sys.platform != "win32":

    def _lower(kind: int, value: int) -> None:
        import resource

        hard = resource.getrlimit(kind)[1]
        if hard != resource.RLIM_INFINITY:
            value = min(value, hard)
        resource.setrlimit(kind, (value, value))
