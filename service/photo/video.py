"""A video of a person turning the head: its sharpest frames as photos.

Told from photos by its first bytes: MP4 and QuickTime, WebM and Matroska; play lists, which lead to other files, are
none of these. It is read in a process of its own, started anew for each video: it opens the one file, gives up the
right to open another, so that nothing in the file leads elsewhere, and may only write to its pipe.
"""

from __future__ import annotations

import os
import struct
import sys
import tempfile
from pathlib import Path
from typing import BinaryIO

from service.errors import CorruptImage, TooComplex, TooManyBytes, TooManyPixels, UnsupportedFormat
from service.photo.container import AVIF_BRANDS, HEIC_BRANDS, HEIC_SEQUENCE_BRANDS
from service.photo.gate import begun, ended
from service.photo.wire import lower_limits

MAX_VIDEO_BYTES = 100_000_000
MAX_PIXELS = 4096 * 2304
"""Of a frame."""
MAX_FRAMES = 1800
"""That are read: a minute at 30 a second. What comes after them is not looked at."""
MOMENTS = 24
"""Frames that are handed on at most."""
MEMORY_BYTES, CPU_SECONDS, WALL_SECONDS = 3 * 1024**3, 60, 300.0
"""Of the process that reads a video."""

_BOOT = "import sys; sys.path.insert(0, sys.argv.pop(1)); from service.photo.video import main; main(sys.argv[1])"
NO_VIDEO, TOO_LARGE = 3, 4
"""Exit statuses of the process."""
MOST_OF_A_FRAME = 32 << 20
"""Bytes of a frame as a JPEG file."""
HEADER = struct.Struct(">I")
"""Length of the frame that follows; 0 ends."""


def is_video(data: bytes) -> bool:
    """Whether a file is a video of one of the formats that are read, by its first bytes."""
    photos = HEIC_BRANDS | HEIC_SEQUENCE_BRANDS | AVIF_BRANDS
    return data[:4] == b"\x1aE\xdf\xa3" or (data[4:8] in (b"ftyp", b"moov", b"mdat") and data[8:12] not in photos)


def expect_video(data: bytes, name: str) -> None:
    """Raise UnsupportedFormat, with the name of the file, where it is no video that is read."""
    if not is_video(data):
        raise UnsupportedFormat(f"{name} is no video that is read: MP4, QuickTime and WebM are")


def sharp_frames(data: bytes) -> list[bytes]:
    """JPEG files of the sharpest frame of each moment of a video, in order of time.

    TooManyBytes, TooManyPixels, TooComplex: it is over a limit. CorruptImage: it cannot be read, or has no frame.
    AvatarError: the process could not be started.
    """
    if len(data) > MAX_VIDEO_BYTES:
        raise TooManyBytes(f"the video has {len(data)} bytes; at most {MAX_VIDEO_BYTES} are accepted")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video"
        path.write_bytes(data)
        root = Path(__file__).resolve().parents[2]
        command = [sys.executable, "-E", "-s", "-c", _BOOT, str(root), str(path)]
        with ended(begun(command, {}), WALL_SECONDS) as (status, out):
            frames = _frames(out.read())
    if status is None:
        raise TooComplex(f"reading the video took more than {WALL_SECONDS:g} s")
    if status == TOO_LARGE:
        raise TooManyPixels(f"the frames of the video have more than {MAX_PIXELS} pixels")
    if not frames and status in (-9, -24):
        raise TooComplex(f"reading the video takes more than {CPU_SECONDS} s of computing")
    if not frames:
        raise CorruptImage("the video cannot be read; MP4, QuickTime and WebM are")
    return frames


def _frames(stream: bytes) -> list[bytes]:
    """The frames that a process wrote, whole ones only."""
    frames, at = [], 0
    while at + HEADER.size <= len(stream):
        (size,) = HEADER.unpack_from(stream, at)
        at += HEADER.size
        if not size or at + size > len(stream):
            break
        frames.append(stream[at : at + size])
        at += size
    return frames


def main(path: str) -> None:
    """The process: writes the sharpest frame of each of so many equal parts of a video, as JPEG files."""
    os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] = "protocol_whitelist;file|threads;1"
    os.environ["OPENCV_LOG_LEVEL"] = "OFF"
    import cv2

    cv2.setNumThreads(1)
    capture = cv2.VideoCapture(path, cv2.CAP_FFMPEG)
    lower_limits(CPU=CPU_SECONDS, AS=MEMORY_BYTES, CORE=0, FSIZE=MOMENTS * MOST_OF_A_FRAME, NOFILE=0)
    if not capture.isOpened():
        sys.exit(NO_VIDEO)
    width, height = (int(capture.get(k)) for k in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        sys.exit(TOO_LARGE)
    told = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    count = min(told, MAX_FRAMES) if told > 0 else MAX_FRAMES
    out, best, at = sys.stdout.buffer, (-1.0, b""), 0
    for number in range(MAX_FRAMES):
        read, frame = capture.read()
        if not read:
            break
        if number * MOMENTS // count != at:
            at = number * MOMENTS // count
            _send(out, best[1])
            best = (-1.0, b"")
        scale = min(480 / max(frame.shape[:2]), 1.0)
        small = cv2.resize(frame, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        sharp = float(cv2.Laplacian(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), cv2.CV_32F).var())
        if sharp > best[0]:
            # Quality 97 takes away less than the video has lost.
            best = (sharp, cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 97])[1].tobytes())
    _send(out, best[1])
    out.write(HEADER.pack(0))
    out.flush()


def _send(out: BinaryIO, frame: bytes) -> None:
    """One frame; an empty one is none."""
    if frame:
        out.write(HEADER.pack(len(frame)) + frame)
