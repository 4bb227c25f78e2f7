"""Memory for looking photos through: known beforehand, shared, and kept to."""

from __future__ import annotations

import asyncio
import io
import struct
import subprocess
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from PIL import Image

from service.api.decoding import FIXED, MIB, MOST, DecodingMemory, budget, cost
from service.jobs.settings import Settings
from service.photo.limits import Limits
from tests.service.api.conftest import TOY, is_problem, open_api
from tests.service.cgroups import Group, group
from tests.support.server import Server, in_threads


def blank_png(side: int, colour: int, depth: int) -> bytes:
    """A black PNG: many pixels in few bytes. Colours: 0 grey, 2 RGB, 6 RGBA."""
    row = b"\0" + bytes(side * {0: 1, 2: 3, 6: 4}[colour] * depth // 8)
    packer = zlib.compressobj(9)
    data = b"".join(packer.compress(row) for _ in range(side)) + packer.flush()

    def chunk(name: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))

    head = struct.pack(">IIBBBBB", side, side, depth, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def saved(side: int, **how: object) -> bytes:
    stream = io.BytesIO()
    Image.linear_gradient("L").resize((side, side)).convert("RGB").save(stream, **how)  # type: ignore[arg-type]
    return stream.getvalue()


PHOTOS = {
    "grey 8": lambda: blank_png(3000, 0, 8),
    "RGBA 16": lambda: blank_png(3000, 6, 16),
    "JPEG": lambda: saved(3000, format="JPEG"),
    "progressive JPEG": lambda: saved(3000, format="JPEG", progressive=True),
    "WebP": lambda: saved(3000, format="WEBP"),
}

PEAK = """
import resource, sys
from service.photo.gate import check_photo
check_photo(sys.stdin.buffer.read())
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss << 10)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the most memory of a process is known on Linux")
@pytest.mark.parametrize("name", PHOTOS)
def test_decoding_takes_no_more_than_was_said(name: str) -> None:
    data = PHOTOS[name]()
    ended = subprocess.run([sys.executable, "-c", PEAK], input=data, capture_output=True, check=True)
    assert int(ended.stdout) <= cost(data, Limits())


def test_every_photo_within_the_limits_fits_into_the_memory_of_the_deployment_files() -> None:
    """2 GiB are what compose file and Kubernetes manifest give a server without a worker."""
    largest = FIXED + Limits().max_pixels * 20
    assert largest <= budget(2 << 30, 0) <= MOST
    assert budget(1 << 40, 0) == MOST
    assert budget(100 * MIB, 0) > 0
    assert budget(1 << 40, 300) == 300 * MIB


def test_shares_are_taken_in_order_and_given_back() -> None:
    async def run() -> tuple[int, list[int]]:
        memory, used, most, order = DecodingMemory(100, 3), 0, 0, list[int]()

        async def one(number: int, share: int) -> None:
            nonlocal used, most
            async with memory.taken(share):
                order.append(number)
                used += share
                most = max(most, used)
                await asyncio.sleep(0.001)
                used -= share

        await asyncio.gather(*(one(number, 30 + 10 * (number % 7)) for number in range(40)))
        assert not memory._held
        return most, order

    most, order = asyncio.run(run())
    assert 50 < most <= 100
    assert order == sorted(order), "a large one is not overtaken for ever"


def test_who_gives_up_waiting_holds_nothing() -> None:
    async def run() -> None:
        memory = DecodingMemory(100, 5)

        async def hold(seconds: float) -> None:
            async with memory.taken(80):
                await asyncio.sleep(seconds)

        first = asyncio.create_task(hold(0.05))
        await asyncio.sleep(0)
        second = asyncio.create_task(hold(9))
        await asyncio.sleep(0.01)
        second.cancel()
        await asyncio.wait({first, second})
        assert not memory._held and not memory._waiting
        await asyncio.wait_for(hold(0), 1)

    asyncio.run(run())


def test_a_photo_that_never_fits_is_told_so(tmp_path: Path) -> None:
    """And is not called too complex, which would say that something is wrong with it."""
    with open_api(Settings(data=tmp_path / "data", program=TOY, reserve_mb=1, decode_mb=100)) as client:
        answer = client.post("/v1/avatars", files={"image": ("x", blank_png(3000, 6, 16))})
        body = is_problem(answer, 413, "needs-memory")
        assert body["limit_mib"] == 100 < body["needed_mib"]
        assert client.post("/v1/avatars", files={"image": ("x", blank_png(300, 6, 16))}).status_code == 202


@pytest.fixture
def container() -> Iterator[Group]:
    """With the memory that the deployment files give a server."""
    yield from group(2 << 30)


@pytest.mark.slow
def test_a_server_stays_within_its_container(container: Group, tmp_path: Path) -> None:
    """Eight photos at once, each of which needs 0.7 GB to decode."""
    server = Server(tmp_path / "data", with_worker=False, within=container.command)
    server.start(ready=False)
    try:
        photo = blank_png(5500, 6, 16)

        def send(number: int) -> int:
            files = {"image": ("x.png", photo, "image/png")}
            return httpx.post(f"{server.url}/v1/avatars", files=files, timeout=300).status_code

        assert in_threads(8, send) == [202] * 8
        assert container.kills() == 0
        assert container.most() <= 2 << 30
    finally:
        server.kill()
