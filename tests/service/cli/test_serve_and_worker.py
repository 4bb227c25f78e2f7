from __future__ import annotations

import subprocess
import sys

import pytest
import typer

from service.cli.app import reported
from service.cli.serve_and_worker import worker
from service.errors import UsageError


def test_a_worker_by_itself_needs_a_database_to_share() -> None:
    with pytest.raises(UsageError, match="Postgres"):
        worker(name="w1")


def test_a_wrong_setting_is_a_usage_error() -> None:
    with pytest.raises(typer.Exit) as leaving, reported(as_json=False):
        worker(jobs=0)
    assert leaving.value.exit_code == 2


def test_other_commands_do_not_load_the_server() -> None:
    """Whoever makes one avatar must not wait for FastAPI, DBOS and SQLAlchemy."""
    program = "import sys, service.cli.app, service.cli.make_and_maps; print(*sys.modules)"
    child = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert not {"fastapi", "uvicorn", "dbos", "sqlalchemy", "psycopg", "fsspec"} & set(child.stdout.split())
