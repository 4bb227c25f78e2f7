"""Writes the entry of a model file into ``service/data/models/models.json``, which the service checks files against."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

MODELS = Path(__file__).parents[2] / "service" / "data" / "models"


def sha256(path: Path) -> str:
    """Hex digest of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def register(name: str, path: Path, facts: dict[str, Any]) -> None:
    """Add or replace the entry ``name``; ``facts`` hold licence, source, inputs, outputs and opset."""
    table = path.parent / "models.json"
    empty = {"schema_version": 1, "models": []}
    content: dict[str, Any] = json.loads(table.read_text()) if table.exists() else empty
    entry = {"name": name, "file": path.name, "sha256": sha256(path), "bytes": path.stat().st_size, **facts}
    others = [m for m in content["models"] if m["name"] != name]
    content["models"] = sorted([*others, entry], key=lambda m: str(m["name"]))
    table.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n")


def check_source(path: Path, expected: str) -> None:
    """SystemExit unless the file has the pinned sha256."""
    found = sha256(path)
    if found != expected:
        raise SystemExit(f"{path}: sha256 is {found}, the pinned source has {expected}")
