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

from PIL import Image, ImageFile

from service.photo.wire import READY, Codec, Note, Output, Reply, Request, Status

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
    Codec.WEBP: ("PIL.WebPImagePlugin", "WebPImageFile"),
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
    """Import the reader of one format, the colour engine and the reader of EXIF.

    The process gives up its right to open files before it looks at a photo, so nothing can be imported later.
    """
    import_module("service.photo.conversions")
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

    Raises:
        Refusal: damaged, of another size than its header states, a sequence of frames, or over the limits.
        MemoryError: more memory than the process may have.
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
    """The image upright, its focal length and a note where that is of another frame.

    Args:
        image: as stored.
        exif: what the reader found.
        turned: whether the reader has undone the turn.
    """
    if not isinstance(exif, bytes):
        return image, 0.0, Note(0)
    from service.photo.conversions import MAX_EXIF_BYTES, read_exif

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


def _to_srgb(image: Image.Image, info: dict[str | tuple[int, int], Any]) -> tuple[Image.Image, Note]:
    """The image in sRGB by what its file says of its colours: a profile, which may be broken, or an exponent."""
    from service.photo.conversions import gamma_to_srgb, profile_to_srgb

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
