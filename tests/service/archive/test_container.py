"""The zip itself: the same bytes, safe names, and never half a file."""

from __future__ import annotations

import errno
import io
import os
import stat
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import IO

import pytest

from service.archive import container
from service.archive.container import MEMBERS, write_file, write_stream, write_zip
from service.errors import OutputFault

ROOT = Path(__file__).resolve().parents[3]
SMALL = {"mesh/head.obj": b"v 0 0 0\n" * 50, "manifest.json": b"{}", "maps/texture.png": bytes(range(256))}


def zipped(members: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    write_zip(stream, members)
    return stream.getvalue()


def test_a_strict_reader_accepts_every_entry() -> None:
    archive = zipfile.ZipFile(io.BytesIO(zipped({name: name.encode() for name in MEMBERS})))
    assert archive.testzip() is None
    assert archive.namelist() == list(MEMBERS)
    for entry in archive.infolist():
        parts = entry.filename.split("/")
        assert ".." not in parts and "" not in parts and "\\" not in entry.filename and ":" not in entry.filename
        mode = entry.external_attr >> 16
        assert stat.S_ISREG(mode), "neither a link nor a folder"
        assert stat.S_IMODE(mode) == 0o644
        assert entry.compress_type == zipfile.ZIP_STORED
        assert entry.date_time == (1980, 1, 1, 0, 0, 0)
        assert not entry.flag_bits & 0x8, "sizes stand before the data, for readers that stream"
        assert entry.extra == b""


@pytest.mark.parametrize("name", ["../evil", "/etc/passwd", "maps/../../evil", "maps/other.png", "C:\\evil", ""])
def test_no_other_name_gets_in(name: str) -> None:
    with pytest.raises(ValueError, match="not a name of the archive"):
        zipped({name: b""})


def test_zip64_where_sizes_need_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit is lowered from 2 GiB to 100 bytes, so entries and offsets go beyond it."""
    monkeypatch.setattr(zipfile, "ZIP64_LIMIT", 100)
    data = zipped(SMALL)
    monkeypatch.undo()
    assert b"PK\x06\x06" in data, "there is no ZIP64 end record"
    archive = zipfile.ZipFile(io.BytesIO(data))
    assert {name: archive.read(name) for name in archive.namelist()} == SMALL


def test_the_file_appears_in_one_step_after_its_content_is_on_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    events: list[str] = []
    real_sync, real_replace = os.fsync, Path.replace

    def sync(handle: int) -> None:
        events.append("folder" if stat.S_ISDIR(os.fstat(handle).st_mode) else "content")
        real_sync(handle)

    def replace(self: Path, target: Path) -> Path:
        events.append("rename")
        assert zipfile.ZipFile(self).testzip() is None, "the renamed file is complete"
        return real_replace(self, target)

    monkeypatch.setattr(os, "fsync", sync)
    monkeypatch.setattr(Path, "replace", replace)
    write_file(tmp_path / "a.zip", SMALL)
    assert events == ["content", "rename", "folder"]
    assert os.listdir(tmp_path) == ["a.zip"]


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT, errno.EIO])
def test_a_disk_that_fails_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    (tmp_path / "a.zip").write_bytes(b"old")

    def fail(stream: IO[bytes], members: object) -> None:
        stream.write(b"PK half a file")
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(container, "write_zip", fail)
    with pytest.raises(OutputFault) as fault:
        write_file(tmp_path / "a.zip", SMALL)
    assert str(tmp_path / "a.zip") in fault.value.message
    assert os.strerror(code).lower() in fault.value.message
    assert isinstance(fault.value.__cause__, OSError)
    assert os.listdir(tmp_path) == ["a.zip"]
    assert (tmp_path / "a.zip").read_bytes() == b"old"


@pytest.mark.skipif(sys.platform == "win32", reason="file size limits are POSIX's")
def test_a_real_limit_on_the_size_of_files(tmp_path: Path) -> None:
    """The kernel refuses to write on after 4 KiB; nothing may be left behind."""
    program = (
        "import resource, signal, sys, pathlib\n"
        "from service.archive.container import write_file\n"
        "from service.errors import OutputFault\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\n"
        "try:\n"
        "    write_file(pathlib.Path(sys.argv[1]), {'mesh/head.glb': bytes(100_000)})\n"
        "except OutputFault as fault:\n"
        "    sys.exit(fault.message)\n"
    )
    child = subprocess.run([sys.executable, "-c", program, str(tmp_path / "a.zip")], cwd=ROOT, capture_output=True)
    assert child.returncode == 1
    assert b"file too large" in child.stderr and b"Traceback" not in child.stderr
    assert os.listdir(tmp_path) == []


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real.zip").write_bytes(b"old")
    (tmp_path / "link.zip").symlink_to("real.zip")
    write_file(tmp_path / "link.zip", SMALL)
    assert (tmp_path / "link.zip").is_symlink()
    assert (tmp_path / "real.zip").read_bytes() == zipped(SMALL)


def test_a_reader_that_goes_away() -> None:
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "wb", buffering=0) as stream, pytest.raises(OutputFault, match="closed it"):
        write_stream(stream, {"mesh/head.glb": bytes(1 << 20)})
