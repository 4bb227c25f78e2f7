"""Looking photos through within a budget of memory: each takes its share before it is decoded, and gives it back.

What a decoder needs is known from the first bytes: the format and the size. So photos that fit together are looked
through together, large ones wait for each other, and one that could never fit is refused with that reason, instead of
ending as a process that the system kills.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass

from service.api.problem_responses import HttpProblem
from service.photo.container import open_container
from service.photo.limits import Limits
from service.photo.wire import Codec

MIB = 1 << 20

FIXED = 64 * MIB
"""Bytes of a decoding process without an image; 37 MiB were measured."""

RESERVE = 512 * MIB
"""Bytes that are left to the server itself, its uploads, its listeners and the page cache of its files."""

MOST = 2600 * MIB
"""Largest budget: two of the largest photos at a time."""

PER_PIXEL = {"webp": 18, "jpeg": 9, "png": 9, "png-alpha": 14, "png-16": 20, "other": 20}
"""Bytes that decoding takes for each pixel, by what the file says of itself.

Measured as the most memory of the decoding process over pixels, images of 4000 and 8000 a side: WebP 17.5; JPEG 5.2,
progressive 7.8; PNG of 8 bits 4.6 to 5.2, with alpha 12.3, of 16 bits 8.3 (grey) to 17.6 (RGB) and 1.2 GB for 8000 x
8000 RGBA. ``tests/service/api/test_decoding.py`` holds them against decoders.
"""


@dataclass(eq=False)
class _Share:
    """Memory that a photo wants, or has."""

    tenant: str
    cost: int
    turn: asyncio.Future[None]


class DecodingMemory:
    """A budget that photos share, in turns of their tenants: whoever has least decoded now comes first.

    Args:
        total: bytes.
        most: photos at a time.
        shared: between tenants. Then what one of them takes beyond its first photo leaves half of the bytes and one
            place to the others, so that nobody waits behind the large photos of somebody else.
    """

    def __init__(self, total: int, most: int, *, shared: bool = False) -> None:
        self.total = total
        self._most = most
        self._shared = shared
        self._held: list[_Share] = []
        self._waiting: list[_Share] = []

    @contextlib.asynccontextmanager
    async def taken(self, cost: int, tenant: str = "") -> AsyncIterator[None]:
        """Hold ``cost`` bytes, as soon as they are free; HttpProblem where there never are so many."""
        if cost > self.total:
            words = f"decoding this photo takes {cost // MIB} MiB of memory, and this server has {self.total // MIB}"
            raise HttpProblem(
                "needs-memory", 413, f"{words} for it; send one with fewer pixels, or of 8 bits without transparency",
                needed_mib=cost // MIB, limit_mib=self.total // MIB,
            )  # fmt: skip
        share = _Share(tenant, cost, asyncio.get_running_loop().create_future())
        self._waiting.append(share)
        self._next()
        try:
            await share.turn
            yield
        finally:
            (self._held if share in self._held else self._waiting).remove(share)
            self._next()

    def _next(self) -> None:
        """Let those in whose turn it is; a tenant that may have no more now holds up nobody else."""
        while True:
            able = [share for share in self._waiting if self._may(share)]
            first = min(able, key=lambda share: len(self._of(share.tenant)), default=None)
            bytes_held = sum(share.cost for share in self._held)
            if first is None or len(self._held) >= self._most or bytes_held + first.cost > self.total:
                return
            self._waiting.remove(first)
            self._held.append(first)
            if not first.turn.done():
                first.turn.set_result(None)

    def _may(self, share: _Share) -> bool:
        own = self._of(share.tenant)
        if not self._shared or not own:
            return True
        return len(own) < self._most - 1 and sum(other.cost for other in own) + share.cost <= self.total // 2

    def _of(self, tenant: str) -> list[_Share]:
        return [share for share in self._held if share.tenant == tenant]


def budget(memory: int, stated_mb: int) -> int:
    """Bytes for decoding on a machine or in a container with so many in all.

    ``stated_mb`` is the setting ``decode_mb``; 0 for what is left beside the server.
    """
    return stated_mb * MIB if stated_mb else max(min(memory - RESERVE, MOST), 2 * FIXED)


def cost(data: bytes, limits: Limits) -> int:
    """Bytes that the process takes that decodes a photo; UnreadableInput for what can be seen without decoding."""
    if not data:
        return FIXED  # the gate has words for it
    container = open_container(data, limits)
    if container.size is None:
        return FIXED + limits.max_pixels * PER_PIXEL["other"]
    width, height = container.size
    return FIXED + width * height * PER_PIXEL[_kind(container.codec, data)]


def _kind(codec: int, data: bytes) -> str:
    if codec == Codec.JPEG:
        return "jpeg"
    if codec == Codec.PNG:
        depth, colour = data[24], data[25]  # of IHDR, which has to come first
        return "png-16" if depth == 16 else "png-alpha" if colour in (3, 4, 6) else "png"
    return "webp" if codec == Codec.WebP else "other"
