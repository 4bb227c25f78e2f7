"""Write the published JSON Schema: ``python -m service.archive.schema`` (``--check`` only compares)."""

from __future__ import annotations

import sys
from pathlib import Path

from service.archive.manifest import schema_text

PUBLISHED = (
    Path(__file__).parents[2] / "docs" / "manifest.schema.json",
    Path(__file__).parents[1] / "data" / "manifest.schema.json",
)
"""For readers of the repository, and shipped with the package."""


def stale() -> list[Path]:
    """Published files that differ from the classes."""
    text = schema_text()
    return [path for path in PUBLISHED if not path.exists() or path.read_text(encoding="utf-8") != text]


def main(arguments: list[str]) -> int:
    """Exit status: 1 when ``--check`` finds a file out of date."""
    old = stale()
    if "--check" in arguments:
        sys.stderr.writelines(f"{path} is out of date: run python -m service.archive.schema\n" for path in old)
        return int(bool(old))
    for path in old:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(schema_text(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
