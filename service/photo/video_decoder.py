"""The process that reads a video: sharp frames of it as JPEG files, one for each moment; see ``service.photo.video``.

It is started anew for each video, opens the one file, gives up the right to open another (so that nothing in the file
leads elsewhere), and may only write to its pipe.
"""

from __future__ import annotations

import os
import struct
import sys

HEADER = struct.Struct(">I")
"""Length of the frame that follows; 0 ends."""
QUALITY = 97
"""Of the JPEG files: what it takes away is less than what a video has lost."""
GREY_SIDE = 480
"""Longer side at which sharpness is compared, pixels."""


def main(path: str, moments: int, most_frames: int, most_pixels: int, memory: int, seconds: int) -> int:
    """Write the sharpest frame of each of ``moments`` equal parts of a video; returns the exit status."""
    os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] = "protocol_whitelist;file|threads;1"
    os.environ["OPENCV_LOG_LEVEL"] = "OFF"
    import cv2

    cv2.setNumThreads(1)
    capture = cv2.VideoCapture(path, cv2.CAP_FFMPEG)
    limit(memory, seconds)
    if not capture.isOpened():
        return 3
    width, height = (int(capture.get(k)) for k in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    if width < 1 or height < 1 or width * height > most_pixels:
        return 4
    told = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    count = min(told, most_frames) if told > 0 else most_frames
    out, best, at = sys.stdout.buffer, (-1.0, b""), 0
    for number in range(most_frames):
        read, frame = capture.read()
        if not read:
            break
        if number * moments // count != at:
            at = number * moments // count
            send(out, best[1])
            best = (-1.0, b"")
        scale = min(GREY_SIDE / max(frame.shape[:2]), 1.0)
        small = cv2.resize(frame, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        sharp = float(cv2.Laplacian(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), cv2.CV_32F).var())
        if sharp > best[0]:
            best = (sharp, cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes())
    send(out, best[1])
    out.write(HEADER.pack(0))
    out.flush()
    return 0


def send(out: object, frame: bytes) -> None:
    """One frame; an empty one is none."""
    if frame:
        out.write(HEADER.pack(len(frame)) + frame)  # type: ignore[attr-defined]


def limit(memory: int, seconds: int) -> None:
    """No other file, no program, no more memory and time than this."""
    if sys.platform != "linux":
        return
    import resource

    for kind, most in (
        (resource.RLIMIT_CPU, seconds), (resource.RLIMIT_AS, memory), (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, 0), (resource.RLIMIT_NOFILE, 0),
    ):  # fmt: skip
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard),) * 2)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], *map(int, sys.argv[2:])))
