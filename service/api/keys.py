"""Who is asking: API keys with quotas, from a file that holds their hashes only.

The file is JSON: ``{"keys": [{"name": "studio", "sha256": "...", "max_unfinished": 20, "per_day": 500}]}``; the two
quotas may be left out. It is read again when it changes, so keys come and go without a restart; two entries of one name
are two keys of one tenant, which is how a key is replaced. ``python -m service.api.keys NAME`` makes a key and prints
it with its entry.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import secrets
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from service.errors import UsageError

log = logging.getLogger(__name__)

ANYBODY = "anybody"
"""The tenant of a server without keys."""

LOOPBACK = ("127.0.0.1", "::1", "localhost")
"""Addresses that only this machine reaches."""

LOOK_S = 1.0
"""Seconds between two looks at the file of keys."""


@dataclass(frozen=True, kw_only=True)
class Tenant:
    """Somebody who may post photos and sees the jobs of these.

    Attributes:
        name: as in the file of keys.
        max_unfinished: jobs that may be unfinished at a time, None for the server's own limit.
        per_day: jobs in 24 hours, None for no limit.
    """

    name: str
    max_unfinished: int | None = None
    per_day: int | None = None


class Keys:
    """All keys of a server; empty for a server without.

    Args:
        file: path of the file, "" for a server without keys.

    Raises:
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
        self._refresh(self._path)
        scheme, _, key = headers.get("authorization", "").partition(" ")
        if scheme.lower() != "bearer":
            key = headers.get("x-api-key", "")
        # Looked up by hash: how long the look-up takes tells nothing about the keys.
        return self._tenants.get(_hash(key.strip()))

    def _refresh(self, path: Path) -> None:
        """Read the file again if it has changed. One that is damaged or gone changes nothing: nobody is locked out."""
        if time.monotonic() - self._looked < LOOK_S:
            return
        self._looked = time.monotonic()
        version = _version(path)
        if version == self._seen:
            return
        self._seen = version
        try:
            self._tenants = _read(path)
        except UsageError as error:
            log.error("the keys stay as they were: %s", error.message)
        else:
            log.info("the keys were read again: there are %d", len(self._tenants))


def make_first_key(path: Path) -> Path | None:
    """Make a file of keys with one key where there is none.

    Args:
        path: of the file of keys.

    Returns:
        The file beside it that holds the key itself, readable for its owner only; None where there were keys.

    Raises:
        UsageError: a file cannot be written.
    """
    key, entry = new_key("first")
    told = path.with_name("first-key.txt")
    try:
        if path.exists():
            return None
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        for file, text in ((told, key), (path, json.dumps({"keys": [entry]}))):
            with os.fdopen(
                os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w", encoding="ascii"
            ) as stream:
                stream.write(text + "\n")
    except OSError as error:
        raise UsageError(f"the first key cannot be written: {error}", field="keys") from error
    return told


def check_exposed(host: str, keys: str, *, anybody: bool) -> None:
    """Refuse to serve everybody in a network unless that is what is wanted.

    Raises:
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
    tenants: dict[str, Tenant] = {}
    try:
        for entry in json.loads(path.read_text("utf-8"))["keys"]:
            digest = str(entry["sha256"])
            if len(digest) != 64 or not entry["name"]:
                raise ValueError("an entry has no name or no sha256 of 64 hex digits")
            tenants[digest.lower()] = Tenant(
                name=str(entry["name"])[:64],
                max_unfinished=_count(entry.get("max_unfinished")),
                per_day=_count(entry.get("per_day")),
            )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UsageError(f"the file of keys {path} cannot be used: {error}", field="keys") from error
    if not tenants:
        raise UsageError(f"the file of keys {path} has no key; without the setting nobody needs one", field="keys")
    return tenants


def new_key(name: str) -> tuple[str, dict[str, str]]:
    """A new key, and its entry for the file."""
    key = secrets.token_urlsafe(32)
    return key, {"name": name, "sha256": _hash(key)}


def _hash(key: str) -> str:
    return hashlib.sha256(key.encode("utf-8", "replace")).hexdigest()


def _count(value: object) -> int | None:
    if value is None:
        return None
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:
        raise ValueError(f"a quota is {value!r}; it has to be a whole number from 1")
    return value


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m service.api.keys NAME")
    made, written = new_key(sys.argv[1])
    sys.stdout.write(f"{made}\n{json.dumps(written)}\n")
