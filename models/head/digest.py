"""Name, licence and checksum of the head model in the box, the file that says them, and commands that change both."""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Callable
from pathlib import Path

from models.head.writing import save_head
from service.head.files import DEFAULT_HEAD, load_head
from service.head.model import HeadModel

BASE_NAME = "avatarme-cc0-head-2"
LICENCE = "CC0-1.0"


def write_digest(path: Path) -> None:
    """Write ``head.json`` beside the file: its name, licence and sha256."""
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    facts = {"file": path.name, "licence": LICENCE, "name": BASE_NAME, "sha256": digest}
    path.with_suffix(".json").write_text(json.dumps(facts, indent=2, sort_keys=True) + "\n", encoding="utf-8")


def change_file(description: str | None, change: Callable[[HeadModel], HeadModel]) -> None:
    """Command line of a module that changes a head file: the one named, or the one in the box."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("head", type=Path, nargs="?", default=DEFAULT_HEAD)
    path = parser.parse_args().head
    save_head(change(load_head(path)), path)
    write_digest(path)
