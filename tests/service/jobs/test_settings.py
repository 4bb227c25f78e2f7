from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from service.errors import UsageError
from service.jobs.runner import Runner
from service.jobs.settings import PREFIX, Settings, from_environment, from_json
from service.jobs.workflow import of_jobs


def test_a_flag_beats_the_environment_and_that_the_default() -> None:
    environment = {"AVATARME_PORT": "9000", "AVATARME_RESULT_HOURS": "1.5", "AVATARME_DATA": "here"}
    settings = from_environment({"port": 9100, "jobs": None}, environment)
    assert (settings.port, settings.result_hours, settings.data, settings.jobs) == (9100, 1.5, Path("here"), 1)


def test_an_empty_variable_counts_as_none() -> None:
    """Would break: ``AVATARME_PORT: "${PORT:-}"`` in a compose file, where nobody has set PORT."""
    assert from_environment({}, {PREFIX + field.name.upper(): "" for field in fields(Settings)}) == Settings()


def test_settings_reach_another_process_unchanged() -> None:
    settings = Settings(data=Path("somewhere"), jobs=3, memory_mb=0, allowed_hosts="a,b")
    assert from_json(settings.to_json()) == settings


@pytest.mark.parametrize(
    ("environment", "words"),
    [
        ({"AVATARME_PORT": "http"}, "AVATARME_PORT is 'http'"),
        ({"AVATARME_JOBS": "0"}, "AVATARME_JOBS is '0'; it has to be a whole number, at least 1"),
        ({"AVATARME_JOB_SECONDS": "nan"}, "AVATARME_JOB_SECONDS is 'nan'"),
        ({"AVATARME_WORKER": "a b"}, "AVATARME_WORKER is 'a b'"),
        ({"AVATARME_WORKER": ".."}, "AVATARME_WORKER is '..'"),
        ({"AVATARME_DATABASE": "mysql://x"}, "postgresql"),
    ],
)
def test_a_wrong_setting_is_named(environment: dict[str, str], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        from_environment({}, environment)


def test_the_password_of_a_database_is_in_no_message() -> None:
    with pytest.raises(UsageError, match="AVATARME_DATABASE has to be") as refused:
        from_environment({}, {"AVATARME_DATABASE": "postgres://me:secret@host/x"})
    assert "secret" not in refused.value.message


@pytest.mark.parametrize(("database", "photos"), [("", 0.1), ("postgresql://host/x", 0.5)])
def test_photos_wait_less_where_nobody_else_asks_the_database(database: str, photos: float, tmp_path: Path) -> None:
    """Would break: a sixth of a second of each draft over HTTP, or many workers that ask one Postgres all the time."""
    settings = Settings(data=tmp_path, database=database)
    queues = of_jobs(cast(Runner, SimpleNamespace(settings=settings))).queues
    assert [queues[name]["polling_interval_sec"] for name in ("avatars", "renders")] == [photos, 2.0]
