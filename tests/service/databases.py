"""A database with its tables, made once and copied: making them takes half a second of flushing to the disk."""

from __future__ import annotations

import atexit
import functools
import shutil
import tempfile
from pathlib import Path

from service.jobs.database import connect, create_tables
from service.jobs.settings import Settings


@functools.cache
def _template() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="avatarme-tables-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    settings = Settings(data=folder)
    engine = connect(settings.database_url)
    create_tables(engine, settings)
    engine.dispose()  # the last connection folds the write-ahead log into the file
    return folder / "jobs.sqlite"


def lay_out(data: Path) -> None:
    """Put a database with empty tables into a data folder that has none."""
    data.mkdir(parents=True, exist_ok=True, mode=0o700)
    if not (data / "jobs.sqlite").exists():
        shutil.copyfile(_template(), data / "jobs.sqlite")
