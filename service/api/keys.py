"""Who is asking: API keys with quotas, from a file that holds their hashes only.

The file is JSON: ``{"keys": [{"name": "studio", "sha256": "...", "max_unfinished": 20, "per_day": 500}]}``; the two
quotas may be left out, other fields are refused. It is read again when it changes, so keys come and go without a
restart; two entries of one name are two keys of one tenant, which is how a key is replaced. ``python -m
service.api.keys NAME`` makes a key and prints it with its entry.
"""

from __future__ import annotations

import hashlib
import json
import logging
import secrets
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from service.errors import UsageError

log = logging.getLogger(__name__)

ANYBODY = "anybody"
"""The tenant of a server without keys."""

LOOPBACK = ("127.0.0.1", "::1", "localhost")
"""Addresses that only this machine reaches."""

LOOK_S = 1.0
"""Seconds between two looks at the file of keys."""


_Count = Annotated[int, Field(strict=True, ge=1)]


class Tenant(BaseModel):
    """Somebody who may post photos and sees the jobs of these.

    Attributes:
        name: as in the file of keys; what the database tells tenants apart by, so it is never cut.
        max_unfinished: jobs that may be unfinished at a time, None for the server's own limit.
        per_day: jobs in 24 hours and photos that were refused after a look at them, None for no limit.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Annotated[str, Field(pattern=r"^[^\x00-\x1f]{1,64}$")]
    max_unfinished: _Count | None = None
    per_day: _Count | None = None


class _Entry(Tenant):
    """One key of the file."""

    sha256: Annotated[str, Field(pattern=r"^[0-9a-fA-F]{64}$")]


class _File(BaseModel):
    """The file of keys."""

    model_config = ConfigDict(extra="forbid")

    keys: Annotated[list[_Entry], Field(min_length=1)]


class Keys:
    """All keys of a server, by the path of their file; empty for a server without ("").

    UsageError: the file cannot be read or is not of the form above.
    """

    def __init__(self, file: str = "") -> None:
        self._path = Path(file) if file else None
        self._looked = time.monotonic()
        self._seen = _version(self._path)
        self._tenants = {} if self._path is None else _read(self._path)

    def __bool__(self) -> bool:
        return self._path is not None

    def tenant(self, headers: Mapping[str, str]) -> Tenant | None:
        """Whose key the headers carry, None for none of ours; everybody is ``ANYBODY`` where there are no keys."""
        if self._path is None:
            return Tenant(name=ANYBODY)
        self._refresh()
        scheme, _, key = headers.get("authorization", "").partition(" ")
        if scheme.lower() != "bearer":
            key = headers.get("x-api-key", "")
        # Looked up by hash: how long the look-up takes tells nothing about the keys.
        return self._tenants.get(_hash(key.strip()))

    def _refresh(self) -> None:
        """Read the file again if it has changed. One that is damaged or gone changes nothing: nobody is locked out."""
        if self._path is None or time.monotonic() - self._looked < LOOK_S:
            return
        self._looked = time.monotonic()
        version = _version(self._path)
        if version == self._seen:
            return
        self._seen = version
        try:
            self._tenants = _read(self._path)
        except UsageError as error:
            log.error("the keys stay as they were: %s", error.message)
        else:
            log.info("the keys were read again: there are %d", len(self._tenants))


def make_first_key(path: Path) -> Path | None:
    """Make a file of keys with one key where there is none; UsageError where it cannot be written.

    Gives the file beside it that holds the key itself, readable for its owner only; None where there were keys.
    """
    key, entry = new_key("first")
    told = path.with_name("first-key.txt")
    try:
        if path.exists():
            return None
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        for file, text in ((told, key), (path, json.dumps({"keys": [entry]}))):
            file.unlink(missing_ok=True)
            file.touch(0o600)
            file.write_text(text + "\n", "ascii")
    except OSError as error:
        raise UsageError(f"the first key cannot be written: {error}", field="keys") from error
    return told


def check_exposed(host: str, keys: str, *, anybody: bool) -> None:
    """Refuse to serve everybody in a network unless that is what is wanted.

    UsageError: the server would listen beyond this machine, has no keys, and nobody said that it need none.
    """
    if host in LOOPBACK or keys or anybody:
        return
    raise UsageError(
        f"host is {host}, which others can reach, and there are no keys; name a file of keys (--keys, AVATARME_KEYS), "
        "or say --anybody (AVATARME_ANYBODY=true) if everybody may use this server",
        field="keys",
    )


def _version(path: Path | None) -> tuple[int, int, int] | None:
    if path is None:
        return None
    try:
        facts = path.stat()
    except OSError:
        return None
    return facts.st_mtime_ns, facts.st_size, facts.st_ino


def _read(path: Path) -> dict[str, Tenant]:
    """Tenants by the hash of their key.

    UsageError: the file cannot be read, has another form, or gives one key to two tenants.
    """
    try:
        entries = _File.model_validate_json(path.read_bytes()).keys
    except OSError as error:
        raise UsageError(f"the file of keys {path} cannot be read: {error}", field="keys") from error
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        words = f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
        raise UsageError(f"the file of keys {path} cannot be used: {words}", field="keys") from error
    tenants: dict[str, Tenant] = {}
    for entry in entries:
        if tenants.setdefault(entry.sha256.lower(), entry) != entry:
            raise UsageError(f"the file of keys {path} has one key for {entry.name!r} and another", field="keys")
    return tenants


def new_key(name: str) -> tuple[str, dict[str, str]]:
    """A new key, and its entry for the file."""
    key = secrets.token_urlsafe(32)
    return key, {"name": Tenant(name=name).name, "sha256": _hash(key)}


def _hash(key: str) -> str:
    return hashlib.sha256(key.encode("utf-8", "replace")).hexdigest()


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m service.api.keys NAME")
    made, written = new_key(sys.argv[1])
    sys.stdout.write(f"{made}\n{json.dumps(written)}\n")
