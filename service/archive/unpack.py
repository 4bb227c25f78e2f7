"""Decode untrusted map PNGs in the photos' decode gate, without colour conversion."""

from __future__ import annotations

import numpy as np

from service.arrays import UInt8
from service.errors import BadArchive, CorruptImage, UnreadableInput
from service.photo.codec import BACKGROUND
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
    codes = _decoded(png, name)
    if codes.shape[1] * 2 != codes.shape[0] * 3:
        raise BadArchive(f"the map {name} is {codes.shape[1]}x{codes.shape[0]}; the chart is 3:2", map=name)
    return codes


def unpack_texture(png: bytes, name: str) -> UInt8:
    """(h, w, 4) uint8 sRGB with straight alpha of a part's own texture, of any shape.

    Colours are read as they are stored over the gate's background; where alpha is 0 they mean nothing.

    Raises:
        BadArchive: not a PNG, or damaged; names the texture.
    """
    colours, alpha = _decoded(png, name).astype(np.float32), _decoded(png, name, alpha=True)[..., :1]
    share = np.maximum(alpha, 1) / np.float32(255)
    straight = (colours - (1 - share) * np.float32(BACKGROUND)) / share
    return np.concatenate([np.rint(np.clip(straight, 0, 255)).astype(np.uint8), alpha], 2)


def _decoded(png: bytes, name: str, *, alpha: bool = False) -> UInt8:
    try:
        container = open_container(png, LIMITS)
        if container.codec != Codec.PNG:
            raise CorruptImage("it is not a PNG")
        # Codes of maps are data: gamma, colour profile and EXIF orientation must not be applied.
        plain = container._replace(icc=b"", gamma=0.0, exif=b"")
        reply, raw = run_decoder(decoding_request(plain, LIMITS)._replace(alpha=alpha), LIMITS)
        if reply.status != Status.DONE or (reply.width, reply.height) != container.size:
            raise CorruptImage("its pixels could not be decoded")
    except UnreadableInput as error:
        raise BadArchive(f"the map {name} cannot be read: {error.message}", map=name) from error
    return np.frombuffer(raw, np.uint8).reshape(reply.height, reply.width, 3)
