"""What the decode gate costs: time, and time and memory of its process.

``python -m benchmarks.gate [PHOTO ...]`` measures the given files, or made ones from a small photo to the largest that
the default limits accept in the costliest encodings. Columns: the whole of ``read_photo`` (best of ``--repeat``), and
processor time and peak memory of the decoding process.
"""

from __future__ import annotations

import argparse
import io
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageCms

from service.errors import UnreadableInput
from service.photo import sandbox
from service.photo.gate import decoding_request, open_container, read_photo
from service.photo.limits import Limits
from service.photo.wire import Request


class Spent(NamedTuple):
    """What one decoding process did: its output without the pixels, processor seconds, and peak memory in MiB."""

    head: bytes
    cpu_seconds: float
    peak_mib: float


def decode_measured(order: Request) -> Spent:
    """Run the decoding process as the gate does and let it report its own peak memory.

    What the system reports to the caller (``ru_maxrss``) will not do: it includes the memory of the caller at the
    moment of starting the process. So the process opens its status before it gives up opening files.
    """
    boot = (
        "import sys; status = open('/proc/self/status'); sys.path[:0] = sys.argv[1:]\n"
        "from service.photo.child import main; code = main(); status.seek(0); sys.stderr.write(status.read())\n"
        "sys.exit(code)"
    )
    command = [boot if part == sandbox._BOOT else part for part in sandbox.decoder_command(order.codec)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, input=order.pack() + order.payload, capture_output=True, env={}, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    report = dict(line.split(":", 1) for line in done.stderr.decode().splitlines() if ":" in line)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Spent(done.stdout[:64], cpu, int(report.get("VmHWM", "0").split()[0]) / 1024)


def measure(data: bytes, repeat: int) -> tuple[float, Spent]:
    """(seconds of the gate, what its decoding process spent)."""
    best = min(_timed(data) for _ in range(repeat))
    container = open_container(data, Limits())
    return best, decode_measured(decoding_request(container, Limits()))


def made() -> Iterator[tuple[str, bytes]]:
    """Files from ordinary to the largest accepted."""
    rng = np.random.default_rng(0)
    tile = Image.fromarray(rng.integers(60, 200, (64, 64, 3), dtype=np.uint8))
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    exif = Image.Exif()
    exif[0x0112] = 6
    small, phone = (tile.resize((side, side), Image.Resampling.BICUBIC) for side in (1024, 3500))
    largest = tile.crop((0, 0, 64, 1)).resize((8000, 8000), Image.Resampling.BICUBIC)
    yield "1024^2 JPEG", _written(small, "JPEG", quality=92)
    yield "1024^2 PNG", _written(small, "PNG")
    yield "1024^2 WebP", _written(small, "WEBP")
    yield "3500^2 JPEG, profile, turned", _written(phone, "JPEG", quality=92, icc_profile=profile, exif=exif)
    yield "8000^2 JPEG, profile, turned", _written(largest, "JPEG", icc_profile=profile, exif=exif)
    yield "8000^2 JPEG, progressive", _written(largest, "JPEG", progressive=True)
    largest.putalpha(200)
    yield "8000^2 PNG with alpha, profile, turned", _written(largest, "PNG", 1, icc_profile=profile, exif=exif)
    yield "8000^2 PNG 16-bit with alpha, turned", _png16(largest, exif)


def main() -> int:
    """Run from the command line; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photos", nargs="*", type=Path)
    parser.add_argument("--repeat", type=int, default=3)
    arguments = parser.parse_args()
    files = ((path.name, path.read_bytes()) for path in arguments.photos) if arguments.photos else made()
    print(f"{'file':42} {'MB':>6} {'gate ms':>8} {'cpu ms':>7} {'MiB':>6}")
    for name, data in files:
        try:
            seconds, spent = measure(data, arguments.repeat)
            numbers = f"{seconds * 1e3:8.0f} {spent.cpu_seconds * 1e3:7.0f} {spent.peak_mib:6.0f}"
            print(f"{name:42} {len(data) / 1e6:6.1f} {numbers}", flush=True)
        except UnreadableInput as refusal:
            print(f"{name:42} {len(data) / 1e6:6.1f} refused: {refusal}", flush=True)
    return 0


def _timed(data: bytes) -> float:
    start = time.perf_counter()
    read_photo(data)
    return time.perf_counter() - start


def _written(image: Image.Image, kind: str, level: int = 6, **options: object) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, kind, compress_level=level, **options)
    return buffer.getvalue()


def _png16(image: Image.Image, exif: Image.Exif) -> bytes:
    """The first row, repeated, as a 16-bit PNG, which Pillow cannot write in colour."""
    from struct import pack
    from zlib import compress, crc32

    row = (np.asarray(image)[0].astype(np.uint16) * 257).astype(">u2").tobytes()
    # All rows are the same, so every row but the first is "no difference from above", which packs well.
    raw = b"\0" + row + (b"\2" + bytes(len(row))) * (image.height - 1)
    header = pack(">IIBBBBB", image.width, image.height, 16, 6, 0, 0, 0)
    out = b"\x89PNG\r\n\x1a\n"
    for kind, body in ((b"IHDR", header), (b"eXIf", exif.tobytes()[6:]), (b"IDAT", compress(raw, 1)), (b"IEND", b"")):
        out += pack(">I", len(body)) + kind + body + pack(">I", crc32(kind + body))
    return out


if __name__ == "__main__":
    sys.exit(main())
