"""Networks as OpenVINO compiled them, kept in the user's cache folder: to read one takes a quarter of the time.

A file is of one network, version of OpenVINO, processor and setting, and begins with the sha256 of what follows. One
that is cut off or changed is thrown away, and the network is compiled as if there had been none; so is the folder safe
to delete at any time, also while programs run. ``AVATARME_CACHE`` names another folder than ``~/.cache/avatarme``;
where it is ``none`` nothing is kept.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import secrets
from collections.abc import Mapping
from pathlib import Path

from service import diagnosis
from service.machine import variable

VARIABLE = "AVATARME_CACHE"
MOST = 24
"""Files that are kept, the latest: two versions of all networks at two settings."""
_DIGEST = 32
"""Bytes of a sha256."""


def folder() -> Path | None:
    """Where compiled networks are kept, whether it is there or not; None where the user wants none."""
    named = variable(VARIABLE)
    if named == "none":
        return None
    usual = variable("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return (Path(named) if named else Path(usual) / "avatarme") / "networks"


def kept() -> tuple[int, float]:
    """How many compiled networks there are, and their megabytes."""
    sizes = [path.stat().st_size for path in _files()]
    return len(sizes), sum(sizes) / 1e6


def place(name: str, data: bytes, version: str, settings: Mapping[str, object]) -> Path | None:
    """The file of a network.

    Args:
        name: of the network.
        data: its model file.
        version: of OpenVINO.
        settings: with which it is compiled.
    """
    where = folder()
    if where is None:
        return None
    facts = [hashlib.sha256(data).hexdigest(), version, diagnosis.cpu(), dict(settings)]
    key = hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()
    return where / f"{name}-{key[:32]}.blob"


def read(path: Path | None) -> bytes | None:
    """What :func:`write` kept; None where there is nothing, or no longer what it was."""
    with contextlib.suppress(OSError):
        data = path.read_bytes() if path is not None else b""
        if data and hashlib.sha256(data[_DIGEST:]).digest() == data[:_DIGEST]:
            return data[_DIGEST:]
        if data and path is not None:
            path.unlink()
    return None


def write(path: Path | None, blob: bytes) -> None:
    """Keep a compiled network where the folder can be written, at once or not at all."""
    if path is None:
        return
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        temporary = path.with_suffix(f".{secrets.token_hex(4)}.part")
        try:
            temporary.write_bytes(hashlib.sha256(blob).digest() + blob)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
        for old in sorted(_files(), key=lambda one: one.stat().st_mtime)[:-MOST]:
            old.unlink(missing_ok=True)


def _files() -> list[Path]:
    where = folder()
    return [] if where is None or not where.is_dir() else list(where.glob("*.blob"))
