"""The only way in for a photo: any bytes go in, a clean upright sRGB image comes out, or an error that says why not.

::

    bytes -> length -> magic -> container walk -> size -> decoding process -> checked pixels -> Photo

Everything up to the size is plain Python over bounded slices and refuses most bad input within a millisecond; native
decoders run in a process of their own only. No name, address or metadata of the input goes further.

A new interpreter is started for each photo (about 100 ms; who expects a photo may start it ahead): forking a server
with threads is unsafe, and a process that serves several photos would let one of them wait for the next. It gets no
site-packages hooks (``-S``), no environment and no file but its pipes.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np

from service.errors import (
    AnimatedImage,
    AvatarError,
    CorruptImage,
    EmptyFile,
    TooComplex,
    TooManyBytes,
    UnsupportedFormat,
)
from service.photo.container import Container, open_container, readable_formats
from service.photo.limits import Limits, check_size
from service.photo.photo import Photo, lacks_colour
from service.photo.wire import READY, REPLY_SIZE, Codec, Note, Output, Reply, Request, Status
from service.words import WarningCode

_NOTES: dict[Note, WarningCode] = {
    Note.TRANSPARENT: "transparent",
    Note.ICC_IGNORED: "icc-ignored",
    Note.EXTRA_IMAGES: "extra-images-ignored",
    Note.FOCAL_IGNORED: "focal-ignored",
}


def read_photo(data: bytes, limits: Limits = Limits()) -> Photo:  # noqa: B008 - frozen
    """Turn the bytes of an image file (JPEG, PNG, WebP or, where the extra ``heic`` is installed, HEIC) into a photo.

    It has (H, W, 3) uint8 sRGB pixels, upright, and no metadata but the focal length.

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
    steps = np.reshape(reply.steps, (8, 8)).astype(np.float32) / np.float32(255) if any(reply.steps) else None
    digest = hashlib.sha256(data).hexdigest()
    return Photo(pixels, reply.focal_35mm or None, digest, tuple(dict.fromkeys(warnings)), steps)


def check_photo(data: bytes, limits: Limits = Limits()) -> None:  # noqa: B008 - frozen
    """Refuse what :func:`read_photo` would refuse, as it does, without holding the pixels in memory."""
    _decoded(data, limits, keep=False)


def _decoded(data: bytes, limits: Limits, *, keep: bool) -> tuple[Container, Reply, bytearray]:
    if not data:
        raise EmptyFile(f"the file is empty; {', '.join(readable_formats())} are accepted")
    if len(data) > limits.max_bytes:
        words = f"the file has {len(data)} bytes; at most {limits.max_bytes} are accepted"
        raise TooManyBytes(words, bytes=len(data), limit=limits.max_bytes)
    container = open_container(data, limits)
    return container, *decode_container(container, limits, keep=keep)


def decode_container(
    container: Container, limits: Limits, output: Output = Output.PHOTO, *, keep: bool = True
) -> tuple[Reply, bytearray]:
    """Have a container decoded in a process of its own, and hold the answer against what its header states.

    Without ``keep`` the pixels are thrown away. Raises as :func:`read_photo`.
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


_BOOT = "import sys; sys.path[:0] = sys.argv[1:]; from service.photo.decoder import main; sys.exit(main())"


def run_decoder(request: Request, limits: Limits, *, keep: bool = True) -> tuple[Reply, bytearray]:
    """Decode one photo in a process of its own: the checked reply and its pixels, none where the status is not DONE.

    Without ``keep`` the pixels are left, for callers that only want to know that they would come.

    Raises:
        CorruptImage: the decoder crashed on these bytes.
        TooComplex: it ran out of time or memory.
        UnsupportedFormat: HEIC is asked for and its decoder is not installed.
        AvatarError: the process could not be started, or broke its protocol; not the photo's fault.
    """
    with ended(_decoder(request.codec), limits.wall_seconds, request.pack() + request.payload) as (status, out):
        started, pixels = out.read(1) == READY, bytearray()
        reply = _reply(out, request.output.channels, limits) if started and status is not None else None
        if reply is None:
            raise _explain(started, status, limits)
        if keep and reply.status == Status.DONE:
            pixels = bytearray(reply.width * reply.height * request.output.channels)
            out.readinto(pixels)  # type: ignore[attr-defined]
    return reply, pixels


Begun = tuple[subprocess.Popen[bytes], BinaryIO]
"""A program of ours in a process of its own, and the file in memory that it writes to."""

_AHEAD: list[Begun] = []


def expect_photo() -> None:
    """Start the process that decodes the next photo, unless it is HEIC; it waits for the photo, its libraries loaded.

    One waits at a time. Where none can be started, the next photo is told so, and not who got ready for it.
    """
    if not _AHEAD:
        with contextlib.suppress(AvatarError):
            _AHEAD.append(_decoder(Codec.JPEG))


def _decoder(codec: Codec) -> Begun:
    """The process that waits, or a new one."""
    with contextlib.suppress(IndexError):
        if codec != Codec.HEIC:
            process, out = _AHEAD.pop()
            if process.poll() is None:
                return process, out
            with process, out:  # somebody has ended it
                pass
    environment = {name: os.environ[name] for name in ("LD_LIBRARY_PATH",) if name in os.environ}
    return begun(decoder_command(codec), environment)


def begun(command: Sequence[str], environment: Mapping[str, str]) -> Begun:
    """Start our own interpreter with our own code, in these variables alone; what it writes it limits itself.

    AvatarError: it could not be started.
    """
    out = os.fdopen(os.memfd_create("out"), "w+b")
    try:
        process = subprocess.Popen(  # noqa: S603 - our own interpreter and our own code, no shell
            command, stdin=subprocess.PIPE, stdout=out, stderr=subprocess.DEVNULL, env=environment,
            start_new_session=True,
        )  # fmt: skip
    except OSError as fault:
        out.close()
        raise AvatarError("the process that decodes photos and videos could not be started") from fault
    return process, out


@contextlib.contextmanager
def ended(begun: Begun, seconds: float, given: bytes = b"") -> Iterator[tuple[int | None, BinaryIO]]:
    """What a process wrote after it was given something on its standard input, stopped after so many seconds.

    Yields its exit status, None where it was stopped; and its standard output.
    """
    process, out = begun
    with process, out:
        try:
            process.communicate(given, timeout=seconds)
            status: int | None = process.returncode
        except BaseException as fault:
            process.kill()
            if not isinstance(fault, subprocess.TimeoutExpired):
                raise
            status = None
        out.seek(0)
        yield status, out


def decoder_command(codec: Codec) -> list[str]:
    """The command line of the decoding process.

    UnsupportedFormat: HEIC is asked for and its decoder is not installed. AvatarError: there is no interpreter or no
    Pillow.
    """
    roots = [str(Path(__file__).resolve().parents[2]), _package_root("PIL")]
    if codec == Codec.HEIC:
        roots.append(_package_root("pillow_heif"))
    if not sys.executable:
        raise AvatarError("photos are decoded in a process of their own, and this program has no Python to start")
    return [sys.executable, "-I", "-S", "-c", _BOOT, *dict.fromkeys(roots)]


def _package_root(name: str) -> str:
    found = importlib.util.find_spec(name)
    if found is not None and found.origin is not None:
        return str(Path(found.origin).resolve().parents[1])
    if name == "pillow_heif":
        raise UnsupportedFormat(
            "the file is a HEIC image, and the decoder for it is not installed; install the extra 'heic'", extra="heic"
        )
    raise AvatarError(f"the package {name}, which decodes photos, is not installed")


def _reply(out: BinaryIO, channels: int, limits: Limits) -> Reply | None:
    """The reply, where it is whole, within the limits and followed by as many bytes of pixels as it states."""
    try:
        reply = Reply.parse(out.read(REPLY_SIZE))
    except ValueError:
        return None
    if reply.status != Status.DONE:
        return reply
    if max(reply.width, reply.height) > limits.max_side or reply.width * reply.height > limits.max_pixels:
        return None
    rest = os.fstat(out.fileno()).st_size - out.tell()
    return reply if rest == reply.width * reply.height * channels else None


def _explain(started: bool, status: int | None, limits: Limits) -> AvatarError:
    """What it means that there is no reply."""
    if status is None or status in (-signal.SIGXCPU, -signal.SIGKILL, -signal.SIGALRM):
        return TooComplex(
            f"decoding took more than {limits.cpu_seconds} s of computing, {limits.wall_seconds:g} s in all "
            f"or {limits.memory_bytes // 1024**2} MiB of memory"
        )
    if started and status < 0:
        return CorruptImage("the image decoder crashed on this file; it is damaged or made to do so")
    return AvatarError(f"the process that decodes photos failed with exit status {status}")
