"""Feed damaged image files to the gate and count what becomes of them.

``python -m tests.tools.gate_fuzz --count 10000`` changes sound files at random (flipped bits, cut, spliced, repeated or
zeroed runs, length fields set to extremes, checksums mended so that the damage reaches the decoder) and decodes each
one. By default the decoder runs in this process under the address-space limit of the gate, which is fast; with
``--child`` each file goes the whole way through ``read_photo`` and a process of its own.

Every file must end as a photo within the limits or as an ``UnreadableInput``; anything else is counted as a fault,
its bytes are kept with ``--keep FOLDER``, and the exit status is 1.
"""

from __future__ import annotations

import argparse
import struct
import sys
import time
import zlib
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from service.errors import CorruptImage, UnreadableInput
from service.photo import decoder
from service.photo.container import open_container
from service.photo.gate import read_photo
from service.photo.limits import Limits, check_size
from service.photo.wire import Output, Request
from tests.service.photo.badimages import png, save

LIMITS = Limits(max_pixels=4_000_000)
"""Smaller than the gate's own, so that a header made larger by a flipped bit does not slow the run down."""


def seeds() -> list[bytes]:
    """Small sound files of every kind that the gate reads."""
    y, x = np.mgrid[:72, :88]
    waves = [127 + 100 * np.sin(x / (5 + c) + y / (9 - c)) for c in range(4)]
    pixels = np.stack(waves, axis=-1).astype(np.uint8)
    colour, alpha = Image.fromarray(pixels[..., :3]), Image.fromarray(pixels)
    exif = Image.Exif()
    exif[0x0112] = 6
    return [
        save(colour, "JPEG", exif=exif),
        save(colour, "JPEG", progressive=True, icc_profile=_profile()),
        save(colour, "JPEG", subsampling=2, restart_marker_blocks=4),
        save(colour.convert("CMYK"), "JPEG"),
        save(colour.convert("L"), "JPEG"),
        save(colour, "PNG", exif=exif, icc_profile=_profile()),
        save(alpha, "PNG"),
        save(colour.quantize(16), "PNG", transparency=3),
        save(colour.convert("1"), "PNG"),
        png(pixels.astype(np.uint16) * 257, 6, 16),
        save(colour, "WEBP"),
        save(alpha, "WEBP", exif=exif),
        save(alpha, "WEBP", lossless=True, icc_profile=_profile()),
    ]


def damage(data: bytes, rng: np.random.Generator) -> bytes:
    """One to four random changes."""
    changed = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        _CHANGES[rng.integers(len(_CHANGES))](changed, rng)
    if changed.startswith(b"\x89PNG") and rng.random() < 0.8:
        mend_png(changed)
    return bytes(changed)


def mend_png(data: bytearray) -> None:
    """Make the checksum of each chunk right again, as far as the lengths lead."""
    position = 8
    while position + 12 <= len(data):
        end = position + 8 + int.from_bytes(data[position : position + 4], "big")
        if end + 4 > len(data):
            return
        data[end : end + 4] = struct.pack(">I", zlib.crc32(data[position + 4 : end]))
        position = end + 4


def decode_here(data: bytes) -> str:
    """Everything that the gate does, but with the decoder in this process."""
    container = open_container(data, LIMITS)
    request = Request(
        container.codec, Output.PHOTO, *(container.size or (0, 0)), LIMITS.max_side, LIMITS.max_pixels,
        LIMITS.memory_bytes, LIMITS.cpu_seconds, LIMITS.wall_seconds, container.payload,
    )  # fmt: skip
    try:
        decoded = decoder.decode(decoder.prepare(container.codec), request)
    except decoder.Refusal as refusal:
        raise CorruptImage("decoder") from refusal
    check_size(*decoded.image.size, LIMITS)
    if decoded.image.mode != "RGB" or sorted(decoded.image.size) != sorted(container.size or ()):
        raise ValueError(f"mode {decoded.image.mode}, size {decoded.image.size}, stated {container.size}")
    return "photo"


def decode_in_child(data: bytes) -> str:
    """The whole gate."""
    photo = read_photo(data, LIMITS)
    check_size(*photo.size, LIMITS)
    return "photo"


def run(count: int, seed: int, decode: Callable[[bytes], str], keep: Path | None = None) -> Counter[str]:
    """Decode ``count`` damaged files; returns how many ended in which way, faults as ``FAULT ...``."""
    rng = np.random.default_rng(seed)
    sound = seeds()
    outcomes: Counter[str] = Counter()
    for index in range(count):
        data = damage(sound[index % len(sound)], rng)
        try:
            outcome = decode(data)
        except UnreadableInput as refusal:
            outcome = f"refused: {refusal.code}"
        except Exception as fault:  # anything else is what this program looks for
            outcome = f"FAULT {type(fault).__name__}: {fault}"
            if keep is not None:
                keep.mkdir(parents=True, exist_ok=True)
                (keep / f"{seed}-{index}.bin").write_bytes(data)
        outcomes[outcome] += 1
    return outcomes


def main() -> int:
    """Run from the command line; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--child", action="store_true", help="the whole gate, one process per file")
    parser.add_argument("--keep", type=Path, help="folder for files that cause a fault")
    arguments = parser.parse_args()
    if sys.platform == "linux" and not arguments.child:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (LIMITS.memory_bytes, resource.getrlimit(resource.RLIMIT_AS)[1]))
    start = time.perf_counter()
    outcomes = run(arguments.count, arguments.seed, decode_in_child if arguments.child else decode_here, arguments.keep)
    seconds = time.perf_counter() - start
    print(f"{outcomes.total()} files in {seconds:.1f} s, {1000 * seconds / max(1, outcomes.total()):.1f} ms each")
    for outcome, number in outcomes.most_common():
        print(f"{number:8d}  {outcome}")
    return int(any(outcome.startswith("FAULT") for outcome in outcomes))


def _flip(data: bytearray, rng: np.random.Generator) -> None:
    for _ in range(rng.integers(1, 9)):
        data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))


def _flip_early(data: bytearray, rng: np.random.Generator) -> None:
    data[rng.integers(min(len(data), 200))] = int(rng.integers(256))


def _cut(data: bytearray, rng: np.random.Generator) -> None:
    del data[max(16, int(rng.integers(len(data)))) :]


def _remove(data: bytearray, rng: np.random.Generator) -> None:
    start = int(rng.integers(8, max(9, len(data))))
    del data[start : start + int(rng.integers(1, 64))]


def _repeat(data: bytearray, rng: np.random.Generator) -> None:
    start, end = sorted(int(v) for v in rng.integers(0, len(data), 2))
    data[start:start] = data[start : min(end, start + 4096)]


def _overwrite(data: bytearray, rng: np.random.Generator) -> None:
    start, length = int(rng.integers(8, max(9, len(data)))), int(rng.integers(1, 64))
    fill = (b"\0", b"\xff", rng.bytes(1))[rng.integers(3)]
    data[start : start + length] = fill * len(data[start : start + length])


def _extreme(data: bytearray, rng: np.random.Generator) -> None:
    value = (b"\0\0", b"\xff\xff", b"\x7f\xff", b"\x80\0", b"\0\1")[rng.integers(5)]
    at = int(rng.integers(8, max(9, min(len(data) - 2, 1000))))
    data[at : at + 2] = value


_CHANGES = (_flip, _flip, _flip_early, _cut, _remove, _repeat, _overwrite, _extreme)


def _profile() -> bytes:
    from PIL import ImageCms

    return ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()


if __name__ == "__main__":
    sys.exit(main())
