"""Who is asking: API keys with quotas, from a file that holds their hashes only.

The file is JSON: ``{"keys": [{"name": "studio", "sha256": "...", "max_unfinished": 20, "per_day": 500}]}``; the two
quotas may be left out. ``python -m service.api.keys NAME`` makes a key and prints it with its entry.
"""

from __future__ import annotations

import hashlib
import json
import secrets
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from service.errors import UsageError

ANYBODY = "anybody"
"""The tenant of a server without keys."""


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

    Raises:
        UsageError: the file cannot be read or is not of the form above.
    """

    def __init__(self, file: str = "") -> None:
        self._tenants: dict[str, Tenant] = {}
        if file:
            self._read(Path(file))

    def __bool__(self) -> bool:
        return bool(self._tenants)

    def tenant(self, headers: Mapping[str, str]) -> Tenant | None:
        """Whose key the headers carry, None for none of ours; everybody is ``ANYBODY`` where there are no keys."""
        if not self._tenants:
            return Tenant(name=ANYBODY)
        scheme, _, key = headers.get("authorization", "").partition(" ")
        if scheme.lower() != "bearer":
            key = headers.get("x-api-key", "")
        # Looked up by hash: how long the look-up takes tells nothing about the keys.
        return self._tenants.get(_hash(key.strip()))

    def _read(self, path: Path) -> None:
        try:
            entries = json.loads(path.read_text("utf-8"))["keys"]
            for entry in entries:
                digest = str(entry["sha256"])
                if len(digest) != 64 or not entry["name"]:
                    raise ValueError("an entry has no name or no sha256 of 64 hex digits")
                self._tenants[digest.lower()] = Tenant(
                    name=str(entry["name"])[:64],
                    max_unfinished=_count(entry.get("max_unfinished")),
                    per_day=_count(entry.get("per_day")),
                )
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UsageError(f"the file of keys {path} cannot be used: {error}", field="keys") from error
        if not self._tenants:
            raise UsageError(f"the file of keys {path} has no key; without the setting nobody needs one", field="keys")


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
