"""The only way in for a photo: any bytes go in, a clean upright sRGB image comes out, or an error that says why not.

::

    bytes -> length -> magic -> container walk -> size -> decoding process -> checked pixels -> Photo

Everything up to the size is plain Python over bounded slices and refuses most bad input within a millisecond; native
decoders run only in the process that ``sandbox`` starts. No name, address or metadata of the input goes further.
"""

from __future__ import annotations

import hashlib
import sys

import numpy as np

from service.errors import AnimatedImage, AvatarError, CorruptImage, EmptyFile, TooComplex
from service.photo.container import Container, open_container
from service.photo.limits import Limits, check_bytes, check_size
from service.photo.photo import Photo, lacks_colour
from service.photo.sandbox import run_decoder
from service.photo.wire import Note, Output, Reply, Request, Status

_NOTES = {
    Note.TRANSPARENT: "transparent",
    Note.ICC_IGNORED: "icc-ignored",
    Note.EXTRA_IMAGES: "extra-images-ignored",
    Note.FOCAL_IGNORED: "focal-ignored",
}


def read_photo(data: bytes, limits: Limits = Limits()) -> Photo:  # noqa: B008 - frozen
    """Turn the bytes of an image file into a photo.

    Args:
        data: the whole file: JPEG, PNG, WebP or, where the extra ``heic`` is installed, HEIC.
        limits: what is accepted, and what decoding may cost.

    Returns:
        (H, W, 3) uint8 sRGB pixels, upright, with no metadata but the focal length. ``warnings`` may hold
        ``no-colour`` (grey or of one tint), ``transparent`` (was put before grey), ``icc-ignored`` (its colour
        profile is broken, so sRGB was assumed), ``extra-images-ignored`` (only the first image was read),
        ``focal-ignored`` (the file states the focal length of another frame) and ``decoder-not-limited`` (this
        system cannot limit the memory of the decoding process).

    Raises:
        UnreadableInput: one of its subclasses, for whatever is wrong with the bytes.
        AvatarError: the installation is broken; never raised for what the bytes are.
    """
    container, reply, raw = _decoded(data, limits, keep=True)
    pixels = np.frombuffer(raw, dtype=np.uint8).reshape(reply.height, reply.width, 3)
    warnings = list(container.warnings)
    warnings += [text for note, text in _NOTES.items() if note in reply.notes]
    if lacks_colour(pixels):
        warnings.append("no-colour")
    if sys.platform != "linux":
        warnings.append("decoder-not-limited")
    steps = np.reshape(reply.steps, (8, 8)).astype(np.float32) / np.float32(255) if any(reply.steps) else None
    digest = hashlib.sha256(data).hexdigest()
    return Photo(pixels, reply.focal_35mm or None, digest, tuple(dict.fromkeys(warnings)), steps)


def check_photo(data: bytes, limits: Limits = Limits()) -> None:  # noqa: B008 - frozen
    """Refuse what :func:`read_photo` would refuse, without holding the pixels in memory.

    Raises:
        UnreadableInput, AvatarError: as :func:`read_photo`.
    """
    _decoded(data, limits, keep=False)


def _decoded(data: bytes, limits: Limits, *, keep: bool) -> tuple[Container, Reply, bytearray]:
    if not data:
        raise EmptyFile("the file is empty; a JPEG, PNG or WebP image is expected")
    check_bytes(len(data), limits)
    container = open_container(data, limits)
    return container, *decode_container(container, limits, keep=keep)


def decode_container(
    container: Container, limits: Limits, output: Output = Output.PHOTO, *, keep: bool = True
) -> tuple[Reply, bytearray]:
    """Have a container decoded in a process of its own, and hold the answer against what its header states.

    Args:
        container: from ``open_container``.
        limits: what decoding may cost.
        output: what the pixels shall be.
        keep: False throws the pixels away.

    Raises:
        UnreadableInput: one of its subclasses, as for ``read_photo``.
        AvatarError: the installation is broken.
    """
    request = Request(
        container.codec, output, *(container.size or (0, 0)), limits.max_side, limits.max_pixels,
        limits.memory_bytes, limits.cpu_seconds, limits.wall_seconds, container.payload,
    )  # fmt: skip
    reply, pixels = run_decoder(request, limits, keep=keep)
    _check(reply, container, limits)
    return reply, pixels


def _check(reply: Reply, container: Container, limits: Limits) -> None:
    """Translate a refusal, and hold the size of the pixels against the size that was read here."""
    name = container.codec.name
    if reply.status == Status.CORRUPT:
        raise CorruptImage(f"the {name} image is damaged: its pixels could not be decoded")
    if reply.status == Status.TOO_COMPLEX:
        raise TooComplex(f"decoding takes more than {limits.memory_bytes // 1024**2} MiB of memory")
    if reply.status == Status.ANIMATED:
        raise AnimatedImage(f"the file holds {reply.width} frames; one is accepted", frames=reply.width)
    check_size(reply.width, reply.height, limits)
    if reply.status != Status.DONE:
        raise CorruptImage(f"the decoder found {reply.width} x {reply.height} pixels and refused them")
    if container.size is not None and sorted(container.size) != sorted((reply.width, reply.height)):
        raise AvatarError(
            f"the decoder returned {reply.width} x {reply.height} pixels of an image of {container.size} pixels"
        )
