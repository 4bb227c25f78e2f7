"""Print what the serving install needs, with versions and hashes: python requirements.py [EXTRA,...]."""

from __future__ import annotations

import sys
from pathlib import Path

LOCKS = Path(__file__).parent / "locks"


def blocks(text: str) -> dict[str, str]:
    """Name of each package of a lock file -> its lines, hashes included."""
    found: dict[str, str] = {}
    name = ""
    for line in text.splitlines():
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        if not line[0].isspace():
            name = line.partition("==")[0].strip()
            found[name] = ""
        found[name] += line + "\n"
    return found


def requirements(extras: list[str], locks: Path = LOCKS) -> str:
    """Pinned requirements with hashes of the project and of some of its extras.

    Args:
        extras: names of extras.
        locks: folder of the lock files.

    Raises:
        FileNotFoundError: there is no lock for an extra.
    """
    needed: dict[str, str] = {}
    for name in ("base", *extras):
        needed |= blocks((locks / f"{name}.txt").read_text("ascii"))
    return "".join(needed[name] for name in sorted(needed))


if __name__ == "__main__":
    wanted = [name.strip() for argument in sys.argv[1:] for name in argument.split(",") if name.strip()]
    sys.stdout.write(requirements(wanted))
