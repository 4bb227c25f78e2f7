"""The short way to the state of a job says what the long way says."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from service.api import accepting
from service.api.context import Glance
from service.api.keys import new_key
from service.jobs.database import EVENTS
from service.jobs.erasure import depart
from service.jobs.settings import Settings
from tests.service.api.conftest import TOY, Api, is_problem, open_api

ARCHIVE: dict[str, Any] = {
    "archive": "x", "sha256": "0" * 64, "bytes": 1, "warnings": ["ä"], "timings": {}, "peak_rss_mb": 1.0,
}  # fmt: skip


@pytest.fixture(autouse=True)
def _photos_are_not_looked_through(monkeypatch: pytest.MonkeyPatch) -> None:
    """The process that does it takes longer than all the rest here; ``test_bad_inputs.py`` is about it."""
    monkeypatch.setattr(accepting, "check_photo", lambda data, limits: None)


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    with open_api(Settings(data=tmp_path / "data", program=TOY, reserve_mb=1)) as client:
        yield Api(client)


def both(api: Api, job: str, monkeypatch: pytest.MonkeyPatch) -> tuple[Any, Any]:
    """Answers of the short and of the long way."""
    assert api.context.glance.state(job, "anybody") is not None
    short = api.client.get(f"/v1/avatars/{job}")
    with monkeypatch.context() as patch:
        patch.setattr(Glance, "state", lambda self, job, tenant: None)
        long = api.client.get(f"/v1/avatars/{job}")
    return short, long


def test_it_says_the_same_at_every_point_of_a_job(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    store = api.context.store
    done, failed = (api.post(options={"seed": seed}).json()["id"] for seed in (1, 2))
    steps: tuple[Callable[[], object], ...] = (
        lambda: True,
        lambda: store.begin(f"{done}.1"),
        lambda: store.progress(done, "fit", 0.123456),
        lambda: store.succeed(done, ARCHIVE, 1e10),
        lambda: store.fail(failed, {"code": "no-face", "status": 422, "detail": "ü"}, 1e10),
    )
    seen = []
    for step in steps:
        assert step()
        for job in (done, failed):
            short, long = both(api, job, monkeypatch)
            assert short.status_code == long.status_code == 200
            assert short.json() == long.json()
            ignored = ("content-length", "x-request-id")
            assert {k: v for k, v in short.headers.items() if k not in ignored} == {
                k: v for k, v in long.headers.items() if k not in ignored
            }
            seen.append(short.json()["state"])
    assert set(seen) == {"queued", "running", "succeeded", "failed"}


def test_what_another_process_changes_is_seen_at_once(api: Api) -> None:
    job = api.post().json()["id"]
    assert api.client.get(f"/v1/avatars/{job}").json()["stage"] is None
    from service.jobs.database import connect
    from service.jobs.store import Store

    other = connect(api.context.settings.database_url)
    Store(other).begin(f"{job}.1")
    Store(other).progress(job, "texture", 0.5)
    other.dispose()
    assert api.client.get(f"/v1/avatars/{job}").json()["stage"] == "texture"


def test_what_is_gone_or_not_there_is_a_problem_as_ever(api: Api) -> None:
    job = api.post().json()["id"]
    api.client.delete(f"/v1/avatars/{job}")
    assert api.client.get(f"/v1/avatars/{job}").json()["state"] == "cancelled"
    api.client.delete(f"/v1/avatars/{job}")
    is_problem(api.client.get(f"/v1/avatars/{job}"), 410, "gone")
    is_problem(api.client.get(f"/v1/avatars/{'0' * 32}"), 404, "not-found")


def test_what_has_expired_says_so(api: Api) -> None:
    job = api.post().json()["id"]
    api.client.delete(f"/v1/avatars/{job}")
    depart(api.context.engine, job, "expired")
    for path in ("", "/archive.zip", "/files", "/events"):
        body = is_problem(api.client.get(f"/v1/avatars/{job}{path}"), 410, "gone")
        assert body["reason"] == "expired"


def test_keys_are_looked_at(tmp_path: Path) -> None:
    import json

    keys = {name: new_key(name) for name in ("ada", "bob")}
    file = tmp_path / "keys.json"
    file.write_text(json.dumps({"keys": [entry for _, entry in keys.values()]}))
    ada, bob = ({"Authorization": f"Bearer {keys[name][0]}"} for name in ("ada", "bob"))
    with open_api(Settings(data=tmp_path / "data", program=TOY, keys=str(file), reserve_mb=1)) as client:
        job = Api(client).post(**ada).json()["id"]
        assert client.get(f"/v1/avatars/{job}", headers=ada).json()["id"] == job
        is_problem(client.get(f"/v1/avatars/{job}", headers=bob), 404, "not-found")
        is_problem(client.get(f"/v1/avatars/{job}"), 401, "unauthorized")


def test_a_database_that_is_locked_does_not_hold_up_other_requests(api: Api) -> None:
    """The look-up is made where all requests are handled, so it has to give up soon."""
    job = api.post().json()["id"]
    glance = api.context.glance
    assert glance.state(job, "anybody") is not None
    path = api.context.settings.data / "jobs.sqlite"
    api.context.engine.dispose()
    glance.close()
    holder = sqlite3.connect(path, isolation_level=None)
    holder.execute("PRAGMA locking_mode=EXCLUSIVE")
    holder.execute("PRAGMA journal_mode=DELETE")
    holder.execute("BEGIN EXCLUSIVE")
    begin = time.monotonic()
    assert glance.state(job, "anybody") is None
    assert time.monotonic() - begin < 1
    holder.close()
    assert glance.state(job, "anybody") is not None


def test_a_job_without_events_goes_the_long_way(api: Api) -> None:
    job = api.post().json()["id"]
    with api.context.engine.begin() as connection:
        connection.execute(EVENTS.delete())
    assert api.context.glance.state(job, "anybody") is None
    assert api.client.get(f"/v1/avatars/{job}").json()["state"] == "queued"


def test_no_file_means_the_long_way(tmp_path: Path) -> None:
    assert Glance("").state("0" * 32, "anybody") is None
    missing = Glance(str(tmp_path / "none.sqlite"))
    assert missing.state("0" * 32, "anybody") is None
    assert not (tmp_path / "none.sqlite").exists()
