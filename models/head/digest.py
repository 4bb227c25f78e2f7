"""Name, licence and checksum of the head model in the box, and the file that says them."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

BASE_NAME = "avatarme-cc0-head-2"
LICENCE = "CC0-1.0"


def write_digest(path: Path) -> None:
    """Write ``head.json`` beside the file: its name, licence and sha256."""
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    facts = {"file": path.name, "licence": LICENCE, "name": BASE_NAME, "sha256": digest}
    path.with_suffix(".json").write_text(json.dumps(facts, indent=2, sort_keys=True) + "\n", encoding="utf-8")
