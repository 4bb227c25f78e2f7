"""The decoding process is limited, cannot do anything but decode, and is not believed."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from service.errors import AvatarError, CorruptImage, TooComplex
from service.photo import gate
from service.photo.gate import read_photo
from service.photo.limits import Limits
from service.photo.wire import READY, REPLY_SIZE, Codec, Note, Output, Reply, Request, Status
from tests.service.photo import badimages as bad

ROOT = Path(__file__).resolve().parents[3]
DEFAULT = Limits()
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="the limits of the decoding process are Linux's")


def request(payload: bytes, kind: Codec, limits: Limits = DEFAULT) -> Request:
    sizes = limits.max_side, limits.max_pixels
    return Request(kind, Output.PHOTO, 0, 0, *sizes, limits.memory_bytes, limits.cpu_seconds, 15.0, payload)


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
        "from service.photo.decoder import main; code = main(); status.seek(0); sys.stderr.write(status.read())\n"
        "sys.exit(code)"
    )
    command = [boot if part == gate._BOOT else part for part in gate.decoder_command(order.codec)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, input=order.pack() + order.payload, capture_output=True, env={}, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    report = dict(line.split(":", 1) for line in done.stderr.decode().splitlines() if ":" in line)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Spent(done.stdout[: 1 + REPLY_SIZE], cpu, int(report.get("VmHWM", "0").split()[0]) / 1024)


def measured(order: Request) -> tuple[Reply, float, float]:
    """(reply, peak memory in MiB, processor seconds) of one decoding process."""
    spent = decode_measured(order)
    assert spent.head[:1] == READY
    assert spent.peak_mib > 10, "no process that runs Python has less"
    return Reply.parse(spent.head[1 : 1 + REPLY_SIZE]), spent.peak_mib, spent.cpu_seconds


@LINUX
def test_bomb_is_refused_by_the_decoder_too_and_costs_no_memory() -> None:
    small = measured(request(bad.save(bad.picture(), "PNG"), Codec.PNG))
    bomb = measured(request(bad.png_bomb(), Codec.PNG))
    assert bomb[0] == Reply(Status.BAD_SIZE, width=30_000, height=30_000)
    assert bomb[1] - small[1] < 50
    assert bomb[2] < 2


@LINUX
def test_memory_of_the_decoder_is_capped() -> None:
    loose = Limits(max_side=40_000, max_pixels=2**31, memory_bytes=256 * 1024**2)
    reply, peak, _ = measured(request(bad.png_bomb(), Codec.PNG, loose))
    assert reply.status == Status.TOO_COMPLEX
    assert peak < 256


@LINUX
def test_bomb_costs_the_calling_process_no_memory() -> None:
    script = """
        import resource
        from service.errors import TooManyPixels
        from service.photo.gate import read_photo
        from tests.service.photo import badimages as bad
        read_photo(bad.save(bad.picture(), "PNG"))
        data = bad.png_bomb()
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        try:
            read_photo(data)
        except TooManyPixels:
            print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    """
    assert int(in_fresh_interpreter(script)) < 50 * 1024


@LINUX
def test_processor_time_is_capped() -> None:
    data = bad.many_scans(4000, 1600, 1600)  # five times the second on a fast processor of 2024
    start = time.perf_counter()
    with pytest.raises(TooComplex, match="1 s of computing"):
        read_photo(data, Limits(max_scans=10_000, cpu_seconds=1, max_bytes=len(data)))
    assert time.perf_counter() - start < 8


def test_wall_time_is_capped() -> None:
    with pytest.raises(TooComplex):
        read_photo(bad.save(bad.picture(), "PNG"), Limits(wall_seconds=0.005))


def test_no_program_runs_but_our_own_decoder(tmp_path: Path) -> None:
    for name in ("gs", "gswin64c", "djpeg", "cwebp", "convert"):
        trap = tmp_path / name
        trap.write_text(f"#!/bin/sh\ntouch {tmp_path}/ran-{name}\n")
        trap.chmod(0o755)
    script = """
        import sys
        started = []
        def watch(event, args):
            if event in ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork", "os.spawn"):
                started.append(args[1][0] if event == "subprocess.Popen" else event)
        sys.addaudithook(watch)
        from service.errors import UnsupportedFormat
        from service.photo.gate import read_photo
        from tests.service.photo import badimages as bad
        for data in bad.NOT_IMAGES.values():
            try:
                read_photo(data)
            except UnsupportedFormat:
                continue
            raise AssertionError
        assert started == [], started
        read_photo(bad.save(bad.picture(), "JPEG"))
        assert started == [sys.executable], started
    """
    in_fresh_interpreter(script, PATH=f"{tmp_path}:/usr/bin:/bin")
    assert not list(tmp_path.glob("ran-*"))


@LINUX
def test_decoder_can_neither_open_nor_start_anything(tmp_path: Path) -> None:
    """What a photo that takes over a native decoder could do: the same process, after it has locked itself."""
    script = f"""
        import os, socket, subprocess
        from service.photo import decoder
        decoder._give_up_files()
        def refused(action):
            try:
                action()
            except OSError:
                return True
            return False
        assert refused(lambda: open("/etc/passwd"))
        assert refused(lambda: open("{tmp_path}/out", "w"))
        assert refused(lambda: socket.socket())
        assert refused(lambda: subprocess.run(["/bin/true"]))
        assert os.system("echo x > {tmp_path}/out") != 0
    """
    in_fresh_interpreter(script)
    assert not list(tmp_path.iterdir())


@LINUX
def test_decoder_has_locked_itself_when_it_looks_at_the_photo(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stands for a taken-over decoder inside the real process: opening a file must fail there."""
    body = """
        import sys; sys.path[:0] = sys.argv[1:]
        from service.photo import decoder
        def taken_over(*_):
            try:
                open('/etc/passwd')
            except OSError:
                raise decoder.Refusal(decoder.Reply(decoder.Status.CORRUPT))
            raise SystemExit(9)
        decoder.decode = taken_over
        sys.exit(decoder.main())
    """
    monkeypatch.setattr(gate, "_BOOT", textwrap.dedent(body))
    with pytest.raises(CorruptImage, match="pixels could not be decoded"):
        read_photo(bad.save(bad.picture(), "PNG"))


# What the process says is checked


def lying_decoder(monkeypatch: pytest.MonkeyPatch, body: str) -> None:
    head = "import os, signal, struct, sys; sys.path[:0] = sys.argv[1:]; from service.photo.wire import *\n"
    monkeypatch.setattr(
        gate, "_BOOT", head + "out = sys.stdout.buffer\nsys.stdin.buffer.read()\n" + textwrap.dedent(body)
    )


@pytest.mark.parametrize(
    "body",
    [
        "sys.exit(1)",
        "out.write(READY)",
        "out.write(READY + b'nonsense' * 100)",
        "out.write(READY + Reply(Status.DONE, width=96, height=80).pack() + bytes(100))",
        "out.write(READY + Reply(Status.DONE, width=96, height=80).pack() + bytes(96 * 80 * 3 + 1))",
        "out.write(READY + Reply(Status.DONE, width=4_000_000_000, height=4_000_000_000).pack())",
        "out.write(READY + Reply(Status.DONE, width=120, height=64).pack() + bytes(96 * 80 * 3))",
        "out.write(READY + struct.pack('>4sBBIId128x', b'AVG3', 9, 0, 96, 80, 0.0) + bytes(96 * 80 * 3))",
        "out.write(READY + struct.pack('>4sBBIId128x', b'AVG3', 0, 0, 96, 80, float('nan')) + bytes(96 * 80 * 3))",
    ],
)
def test_decoder_is_not_believed(body: str, monkeypatch: pytest.MonkeyPatch) -> None:
    lying_decoder(monkeypatch, body)
    with pytest.raises(AvatarError) as caught:
        read_photo(bad.save(bad.picture(), "PNG"))
    assert type(caught.value) is AvatarError, "this is a fault of ours, not of the photo"


@LINUX
@pytest.mark.parametrize("name", ["SIGSEGV", "SIGABRT", "SIGBUS"])
def test_crash_of_a_native_decoder_is_the_photo_s_fault(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    lying_decoder(monkeypatch, f"out.write(READY); out.flush(); os.kill(os.getpid(), signal.{name})")
    with pytest.raises(CorruptImage, match="crashed"):
        read_photo(bad.save(bad.picture(), "PNG"))


def test_decoder_that_hangs_after_closing_its_pipe_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    lying_decoder(monkeypatch, "import time\nout.write(READY); out.flush(); os.close(1); time.sleep(60)")
    start = time.perf_counter()
    with pytest.raises(TooComplex):
        read_photo(bad.save(bad.picture(), "PNG"), Limits(wall_seconds=0.5))
    assert time.perf_counter() - start < 5


def test_decoder_that_never_reads_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "_BOOT", "import time; time.sleep(60)")
    noise = np.random.default_rng(0).integers(0, 256, (600, 600, 3), dtype=np.uint8)
    with pytest.raises(TooComplex):
        read_photo(bad.save(noise, "PNG"), Limits(wall_seconds=0.5))


def test_nothing_is_left_behind() -> None:
    descriptors, threads = len(os.listdir("/proc/self/fd")), threading.active_count()
    for data in (bad.save(bad.picture(), "PNG"), bad.save(bad.picture(), "WEBP")):
        for _ in range(3):
            read_photo(data)
    with pytest.raises(TooComplex):
        read_photo(data, Limits(wall_seconds=0.005))
    assert len(os.listdir("/proc/self/fd")) == descriptors
    assert threading.active_count() == threads


# Messages and faults


def test_messages_survive_the_wire() -> None:
    order = request(b"payload", Codec.PNG)._replace(output=Output.CODES, width=96, height=80)
    assert Request.parse(order.pack() + order.payload) == order
    reply = Reply(Status.DONE, Note.TRANSPARENT | Note.ICC_IGNORED, 12, 34, 28.0, tuple(range(64)))
    assert Reply.parse(reply.pack()) == reply
    for message in (b"", order.pack(), b"x" * 200):
        with pytest.raises(ValueError, match="request"):
            Request.parse(message)


def in_fresh_interpreter(script: str, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)],
        cwd=ROOT,
        env={"PATH": "/usr/bin:/bin", **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout
