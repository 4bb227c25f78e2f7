from __future__ import annotations

from pathlib import Path

import pytest

from service.errors import UsageError
from service.jobs.settings import Settings, from_environment, from_json


def test_a_flag_beats_the_environment_and_that_the_default() -> None:
    environment = {"AVATARME_PORT": "9000", "AVATARME_RESULT_HOURS": "1.5", "AVATARME_DATA": "here"}
    settings = from_environment({"port": 9100, "jobs": None}, environment)
    assert (settings.port, settings.result_hours, settings.data, settings.jobs) == (9100, 1.5, Path("here"), 1)


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
