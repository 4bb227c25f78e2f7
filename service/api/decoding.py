"""Looking photos through within a budget of memory: each takes its share before it is decoded, and gives it back.

What a decoder needs is known from the first bytes: the format and the size. So photos that fit together are looked
through together, large ones wait for each other, and one that could never fit is refused with that reason, instead of
ending as a process that the system kills.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import AsyncIterator

from service.api.problem_responses import ProblemError
from service.photo.container import Codec
from service.photo.gate import open_container
from service.photo.limits import Limits

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


class DecodingMemory:
    """A budget that photos share, first come first served.

    Args:
        total: bytes.
        most: photos at a time.
    """

    def __init__(self, total: int, most: int) -> None:
        self.total = total
        self._most = most
        self._used = self._count = 0
        self._waiting: deque[tuple[int, asyncio.Future[None]]] = deque()

    @contextlib.asynccontextmanager
    async def taken(self, cost: int) -> AsyncIterator[None]:
        """Hold ``cost`` bytes, as soon as they are free.

        Raises:
            ProblemError: there never are so many.
        """
        if cost > self.total:
            words = f"decoding this photo takes {cost // MIB} MiB of memory, and this server has {self.total // MIB}"
            raise ProblemError(
                "needs-memory", 413, f"{words} for it; send one with fewer pixels, or of 8 bits without transparency",
                needed_mib=cost // MIB, limit_mib=self.total // MIB,
            )  # fmt: skip
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.append((cost, turn))
        self._next()
        try:
            await turn
        except asyncio.CancelledError:
            if turn.done() and not turn.cancelled():
                self._release(cost)
            else:
                self._waiting.remove((cost, turn))
                self._next()
            raise
        try:
            yield
        finally:
            self._release(cost)

    def _release(self, cost: int) -> None:
        self._used -= cost
        self._count -= 1
        self._next()

    def _next(self) -> None:
        while self._waiting and self._count < self._most and self._used + self._waiting[0][0] <= self.total:
            cost, turn = self._waiting.popleft()
            if turn.cancelled():
                continue
            self._used += cost
            self._count += 1
            turn.set_result(None)


def budget(memory: int, stated_mb: int) -> int:
    """Bytes for decoding on a machine or in a container with so many.

    Args:
        memory: bytes of all.
        stated_mb: setting ``decode_mb``; 0 for what is left beside the server.
    """
    return stated_mb * MIB if stated_mb else max(min(memory - RESERVE, MOST), 2 * FIXED)


def cost(data: bytes, limits: Limits) -> int:
    """Bytes that the process takes that decodes a photo.

    Raises:
        UnreadableInput: one of its subclasses, for what can be seen without decoding.
    """
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
    return "webp" if codec == Codec.WEBP else "other"
