"""The tables where they are missing: those of the service, and those of DBOS."""

from __future__ import annotations

import logging

import sqlalchemy as sa

from service.jobs.database import TABLES, add_columns
from service.jobs.locks import TABLES_PATIENCE, FileLock
from service.jobs.settings import Settings


def create_tables(engine: sa.Engine, settings: Settings) -> None:
    """Make the tables of the service and of DBOS where they are missing; several processes may do it at once."""
    from dbos import DBOS

    held = FileLock(settings.data, "tables", TABLES_PATIENCE) if settings.database_url.startswith("sqlite") else None
    try:
        with engine.begin() as connection:
            if engine.dialect.name != "sqlite":
                connection.execute(sa.text("select pg_advisory_xact_lock(4242001)"))
            TABLES.create_all(connection)
            add_columns(connection)
        logging.getLogger("dbos").setLevel(logging.WARNING)
        DBOS.migrate(settings.database_url)
    finally:
        if held is not None:
            held.release()
