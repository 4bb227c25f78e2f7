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
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from service.errors import CorruptImage, TooComplex, TooManyBytes, TooManyPixels, UnsupportedFormat
from service.photo.container import AVIF_BRANDS, HEIC_BRANDS, HEIC_SEQUENCE_BRANDS
from service.photo.gate import begun, ended
from service.photo.wire import lower_limits


@dataclass(frozen=True)
class VideoLimits:
    """Bounds on a video and on the process that reads it.

    Attributes:
        max_bytes: largest file.
        max_pixels: of a frame.
        max_frames: that are read; a minute at 30 a second. What comes after them is not looked at.
        moments: frames that are handed on at most.
        memory_bytes, cpu_seconds, wall_seconds: of the process.
    """

    max_bytes: int = 100_000_000
    max_pixels: int = 4096 * 2304
    max_frames: int = 1800
    moments: int = 24
    memory_bytes: int = 3 * 1024**3
    cpu_seconds: int = 60
    wall_seconds: float = 300.0


_BOOT = "import sys; sys.path.insert(0, sys.argv.pop(1)); from service.photo.video import main; main(*sys.argv[1:])"
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


def sharp_frames(data: bytes, limits: VideoLimits = VideoLimits()) -> list[bytes]:
    """JPEG files of the sharpest frame of each moment of a video, in order of time.

    TooManyBytes, TooManyPixels, TooComplex: it is over a limit. CorruptImage: it cannot be read, or has no frame.
    AvatarError: the process could not be started.
    """
    if len(data) > limits.max_bytes:
        raise TooManyBytes(f"the video has {len(data)} bytes; at most {limits.max_bytes} are accepted")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video"
        path.write_bytes(data)
        numbers = (limits.moments, limits.max_frames, limits.max_pixels, limits.memory_bytes, limits.cpu_seconds)
        root = Path(__file__).resolve().parents[2]
        command = [sys.executable, "-E", "-s", "-c", _BOOT, str(root), str(path), *map(str, numbers)]
        with ended(begun(command, {}), limits.wall_seconds) as (status, out):
            frames = _frames(out.read())
    if status is None:
        raise TooComplex(f"reading the video took more than {limits.wall_seconds:g} s")
    if status == TOO_LARGE:
        raise TooManyPixels(f"the frames of the video have more than {limits.max_pixels} pixels")
    if not frames and status in (-9, -24):
        raise TooComplex(f"reading the video takes more than {limits.cpu_seconds} s of computing")
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


def main(path: str, *numbers: str) -> None:
    """The process: writes the sharpest frame of each of so many equal parts of a video, as JPEG files."""
    moments, most_frames, most_pixels, memory, seconds = map(int, numbers)
    os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] = "protocol_whitelist;file|threads;1"
    os.environ["OPENCV_LOG_LEVEL"] = "OFF"
    import cv2

    cv2.setNumThreads(1)
    capture = cv2.VideoCapture(path, cv2.CAP_FFMPEG)
    lower_limits(CPU=seconds, AS=memory, CORE=0, FSIZE=moments * MOST_OF_A_FRAME, NOFILE=0)
    if not capture.isOpened():
        sys.exit(NO_VIDEO)
    width, height = (int(capture.get(k)) for k in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    if width < 1 or height < 1 or width * height > most_pixels:
        sys.exit(TOO_LARGE)
    told = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    count = min(told, most_frames) if told > 0 else most_frames
    out, best, at = sys.stdout.buffer, (-1.0, b""), 0
    for number in range(most_frames):
        read, frame = capture.read()
        if not read:
            break
        if number * moments // count != at:
            at = number * moments // count
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
