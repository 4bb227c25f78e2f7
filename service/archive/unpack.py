"""Decode untrusted map PNGs in the photos' decode gate, without colour conversion."""

from __future__ import annotations

import numpy as np

from service.arrays import UInt8
from service.errors import BadArchive, CorruptImage, UnreadableInput
from service.photo.container import Codec
from service.photo.gate import decoding_request, open_container
from service.photo.limits import Limits
from service.photo.sandbox import run_decoder
from service.photo.wire import Status

LIMITS = Limits(
    max_bytes=512 << 20, min_side=8, max_side=8192, max_pixels=40_000_000, max_aspect=2.0, cpu_seconds=60,
    wall_seconds=120.0,
)  # fmt: skip
"""A map of 6144 x 4096 takes a second to decode, more on a busy machine."""


def unpack_map(png: bytes, name: str) -> UInt8:
    """(H, W, 3) uint8 codes of a PNG, 3:2; grey has three equal channels, 16-bit codes are rounded: code / 257.

    Raises:
        BadArchive: not a PNG, damaged, or of another shape; names the map.
    """
    try:
        container = open_container(png, LIMITS)
        if container.codec != Codec.PNG:
            raise CorruptImage("it is not a PNG")
        # Codes of maps are data: gamma, colour profile and EXIF orientation must not be applied.
        plain = container._replace(icc=b"", gamma=0.0, exif=b"")
        reply, raw = run_decoder(decoding_request(plain, LIMITS), LIMITS)
        if reply.status != Status.DONE or (reply.width, reply.height) != container.size:
            raise CorruptImage("its pixels could not be decoded")
    except UnreadableInput as error:
        raise BadArchive(f"the map {name} cannot be read: {error.message}", map=name) from error
    if reply.width * 2 != reply.height * 3:
        raise BadArchive(f"the map {name} is {reply.width}x{reply.height}; the chart is 3:2", map=name)
    return np.frombuffer(raw, np.uint8).reshape(reply.height, reply.width, 3)
