"""A walk over the segments of a JPEG file (ITU-T T.81, annex B)."""

from __future__ import annotations

import re
from typing import NoReturn

import numpy as np
import numpy.typing as npt

from service.errors import CorruptImage, TooComplex, UnsupportedFormat
from service.photo.container import MAX_ICC_BYTES, Codec, Container
from service.photo.limits import Limits

MAX_SEGMENTS = 8192

_SOI, _EOI, _SOS, _DHT, _DQT, _DRI, _DAC, _DNL = 0xD8, 0xD9, 0xDA, 0xC4, 0xDB, 0xDD, 0xCC, 0xDC
_APP0, _APP1, _APP2, _APP14 = 0xE0, 0xE1, 0xE2, 0xEE
_FRAMES = frozenset(range(0xC0, 0xD0)) - {_DHT, 0xC8, _DAC}
_TABLES = frozenset((_DHT, _DQT, _DRI, _DAC))
# Inside entropy-coded data 0xFF is always followed by a stuffed zero or a restart number (T.81, B.1.1.5).
_MARKER = re.compile(rb"\xff([^\x00\xd0-\xd7\xff])")


class _Walk:
    """What has been collected on the way through one file."""

    def __init__(self, data: bytes, limits: Limits) -> None:
        self.data = data
        self.limits = limits
        self.size: tuple[int, int] | None = None
        self.kept: list[bytes] = [b"\xff\xd8"]
        self.exif = b""
        self.icc: dict[int, bytes] = {}
        self.icc_total = 0
        self.warnings: list[str] = []
        self.scans = 0

    def segment(self, start: int) -> bytes:
        """Body of the segment whose two length bytes are at ``start``."""
        length = int.from_bytes(self.data[start : start + 2], "big")
        body = self.data[start + 2 : start + length]
        if length < 2 or len(body) != length - 2:
            _cut_off(start)
        return body

    def keep(self, marker: int, body: bytes) -> None:
        self.kept.append(b"\xff" + bytes((marker,)) + (len(body) + 2).to_bytes(2, "big") + body)

    def frame(self, body: bytes, marker: int) -> None:
        if self.size is not None:
            raise CorruptImage("the JPEG file has more than one frame header")
        if len(body) < 6 or len(body) != 6 + 3 * body[5]:
            raise CorruptImage("the JPEG frame header is damaged")
        if body[0] != 8 or marker in (0xC3, 0xC7, 0xCB, 0xCF):
            raise UnsupportedFormat(f"the JPEG file has {body[0]} bits a sample or is lossless; 8 bits are accepted")
        self.size = int.from_bytes(body[3:5], "big"), int.from_bytes(body[1:3], "big")

    def application(self, marker: int, body: bytes) -> None:
        if marker == _APP1 and body.startswith(b"Exif\0\0") and not self.exif:
            self.exif = body[6:]
        elif marker == _APP2 and body.startswith(b"ICC_PROFILE\0") and len(body) >= 14:
            self.icc[body[12]] = body[14:]
            self.icc_total = body[13]
        elif marker == _APP2 and body.startswith(b"MPF\0"):
            self.warnings.append("extra-images-ignored")
        elif (marker == _APP14 and body.startswith(b"Adobe")) or (marker == _APP0 and body.startswith(b"JFIF\0")):
            self.keep(marker, body)

    def profile(self) -> bytes:
        """The colour profile, put together from its numbered parts; empty where parts are missing."""
        if not self.icc:
            return b""
        whole = b"".join(self.icc[number] for number in sorted(self.icc))
        if sorted(self.icc) != list(range(1, self.icc_total + 1)) or len(whole) > MAX_ICC_BYTES:
            self.warnings.append("icc-ignored")
            return b""
        return whole


def walk_jpeg(data: bytes, limits: Limits) -> Container:
    """Take a JPEG file apart up to the end of its first image.

    Args:
        data: the file, beginning with its start-of-image marker.
        limits: bounds; only ``max_scans`` is used here.

    Returns:
        The container; ``payload`` holds tables, frame, scans and the Adobe and JFIF segments that tell the colour
        space, and ends at the first end-of-image marker.

    Raises:
        CorruptImage: the file is cut off, its segments do not fit together, or it has no frame or no scan.
        TooComplex: more scans or segments than a photo has.
        UnsupportedFormat: not 8 bits a sample, or lossless.
    """
    walk = _Walk(data, limits)
    position = 2
    for _ in range(MAX_SEGMENTS):
        found = _MARKER.search(data, position)
        if found is None:
            _cut_off(len(data))
        marker, position = data[found.start() + 1], found.end()
        if marker == _EOI:
            return _finish(walk, position)
        if marker in (0x01, _SOI) or 0x02 <= marker < 0xC0:
            raise CorruptImage(
                f"the JPEG file is damaged near byte {found.start()}: marker {marker:#04x} is not valid there"
            )
        body = walk.segment(position)
        position += len(body) + 2
        if marker == _SOS:
            position = _scan(walk, body, position)
        elif marker in _FRAMES:
            walk.frame(body, marker)
            walk.keep(marker, body)
        elif marker in _TABLES:
            walk.keep(marker, body)
        elif marker == _DNL:
            raise CorruptImage("the JPEG file states its height after the first scan, which is not accepted")
        else:
            walk.application(marker, body)
    raise TooComplex(f"the JPEG file has more than {MAX_SEGMENTS} segments")


def luma_steps(payload: bytes) -> npt.NDArray[np.float32] | None:
    """(8, 8) float32 steps of the first quantisation table of a walked JPEG file over 255, rows by vertical frequency.

    That is by custom the table of luma. A coefficient of the orthonormal 8 x 8 cosine transform is rounded to a
    multiple of its step. None where the file has no whole table (T.81, B.2.4.1).
    """
    position = 2
    while position + 4 <= len(payload) and payload[position] == 0xFF and payload[position + 1] != _SOS:
        marker, length = payload[position + 1], int.from_bytes(payload[position + 2 : position + 4], "big")
        body = payload[position + 4 : position + 2 + length]
        if marker == _DQT and body:
            wide = body[0] >> 4
            if len(body) < 1 + 64 * (1 + wide):
                return None
            steps = np.frombuffer(body[1 : 1 + 64 * (1 + wide)], ">u2" if wide else ">u1").astype(np.float32)
            table = np.zeros(64, np.float32)
            table[_ZIGZAG] = steps
            return np.asarray(table.reshape(8, 8) / np.float32(255), np.float32)
        position += 2 + length
    return None


def _zigzag() -> npt.NDArray[np.int64]:
    """(64,) place, row by row, of the coefficients in the order of a table (T.81, figure A.6)."""
    places = [(row, column) for row in range(8) for column in range(8)]
    places.sort(key=lambda at: (sum(at), at[0] if sum(at) % 2 else at[1]))
    return np.array([8 * row + column for row, column in places])


_ZIGZAG = _zigzag()


def _scan(walk: _Walk, header: bytes, position: int) -> int:
    """Keep one scan with its entropy-coded data; returns where the next marker begins."""
    if walk.size is None:
        raise CorruptImage("the JPEG file has a scan before its frame header")
    walk.scans += 1
    if walk.scans > walk.limits.max_scans:
        raise TooComplex(
            f"the JPEG file has more than {walk.limits.max_scans} scans; an ordinary photo has 1 to 20",
            limit=walk.limits.max_scans,
        )
    found = _MARKER.search(walk.data, position)
    if found is None:
        _cut_off(len(walk.data))
    walk.keep(_SOS, header)
    walk.kept.append(walk.data[position : found.start()])
    return found.start()


def _finish(walk: _Walk, end: int) -> Container:
    if walk.size is None or not walk.scans:
        raise CorruptImage("the JPEG file ends before its first scan")
    if walk.data[end : end + 64].lstrip(b"\0").startswith(b"\xff\xd8\xff"):
        walk.warnings.append("extra-images-ignored")
    walk.kept.append(b"\xff\xd9")
    icc = walk.profile()
    warnings = tuple(dict.fromkeys(walk.warnings))
    return Container(Codec.JPEG, walk.size, b"".join(walk.kept), walk.exif, icc, warnings=warnings)


def _cut_off(position: int) -> NoReturn:
    raise CorruptImage(f"the JPEG file is cut off or damaged near byte {position}", position=position)
