"""Keys and quotas, a full house, and a server that shuts down."""

from __future__ import annotations

import json
import shutil
from collections import namedtuple
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.api import avatars
from service.api.keys import Keys, new_key
from service.errors import UsageError
from service.jobs.settings import Settings
from service.jobs.store import depart
from tests.service.api.conftest import GOOD, TOY, Api, is_problem, open_api
from tests.service.photo.badimages import picture, save

KEYS = {name: new_key(name) for name in ("ada", "bob", "eve")}


def bearer(name: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {KEYS[name][0]}"}


@pytest.fixture(autouse=True)
def _photos_are_not_looked_through(monkeypatch: pytest.MonkeyPatch) -> None:
    """The process that does it takes longer than all the rest here; ``test_bad_inputs.py`` is about it."""
    monkeypatch.setattr(avatars, "check_photo", lambda data, limits: None)


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    entries = [KEYS["ada"][1], {**KEYS["bob"][1], "max_unfinished": 2}, {**KEYS["eve"][1], "per_day": 1}]
    file = tmp_path / "keys.json"
    file.write_text(json.dumps({"keys": entries}))
    settings = Settings(data=tmp_path / "data", program=TOY, keys=str(file), reserve_mb=1, max_queued=6, uploads=2)
    with open_api(settings) as client:
        yield Api(client)


def test_without_a_key_nothing_is_given_or_taken(api: Api) -> None:
    for headers in ({}, {"Authorization": "Bearer wrong"}, {"Authorization": "Basic x"}, {"X-API-Key": ""}):
        answer = api.client.get("/v1/avatars", headers=headers)
        is_problem(answer, 401, "unauthorized")
        assert answer.headers["www-authenticate"] == "Bearer"
        is_problem(api.client.post("/v1/avatars", files={"image": ("x", GOOD)}, headers=headers), 401, "unauthorized")
    assert api.stored() == []
    assert api.client.get("/livez").status_code == 200
    assert api.client.get("/v1/models").status_code == 200


def test_nobody_sees_the_jobs_of_another(api: Api) -> None:
    job = api.post(**bearer("ada")).json()["id"]
    strange = "0" * 32
    for path in ("", "/events", "/archive.zip", "/files", "/files/manifest.json"):
        theirs = api.client.get(f"/v1/avatars/{job}{path}", headers=bearer("bob"))
        nobodys = api.client.get(f"/v1/avatars/{strange}{path}", headers=bearer("bob"))
        is_problem(theirs, 404, "not-found")
        assert theirs.text.replace(job, "") == nobodys.text.replace(strange, ""), "both have to look the same"
    is_problem(api.client.delete(f"/v1/avatars/{job}", headers=bearer("bob")), 404, "not-found")
    assert api.client.get("/v1/avatars", headers=bearer("bob")).json()["items"] == []
    assert [item["id"] for item in api.client.get("/v1/avatars", headers=bearer("ada")).json()["items"]] == [job]


def test_what_has_expired_says_so(api: Api) -> None:
    job = api.post(**bearer("ada")).json()["id"]
    api.client.delete(f"/v1/avatars/{job}", headers=bearer("ada"))
    depart(api.context.engine, job, "expired")
    for path in ("", "/archive.zip", "/files", "/events"):
        body = is_problem(api.client.get(f"/v1/avatars/{job}{path}", headers=bearer("ada")), 410, "gone")
        assert body["reason"] == "expired"


def test_a_quota_is_kept(api: Api) -> None:
    for _ in range(2):
        assert api.post(**bearer("bob")).status_code == 202
    answer = api.post(**bearer("bob"))
    is_problem(answer, 429, "quota")
    assert int(answer.headers["retry-after"]) > 0
    assert api.post(**bearer("ada")).status_code == 202, "the quota of one is not that of another"
    assert api.post(**bearer("eve")).status_code == 202
    is_problem(api.post(**bearer("eve")), 429, "quota")


def test_a_full_queue_takes_nothing_and_stores_nothing(api: Api) -> None:
    for _ in range(6):
        assert api.post(**bearer("ada")).status_code == 202
    before = api.stored()
    answer = api.post(**bearer("ada"))
    is_problem(answer, 429, "queue-full")
    assert "retry-after" in answer.headers
    assert api.stored() == before


def test_a_repeated_request_is_answered_even_when_the_queue_is_full(api: Api) -> None:
    first = api.post(**bearer("ada"), Idempotency_Key="k").json()["id"]
    for _ in range(5):
        api.post(**bearer("ada"))
    assert api.post(**bearer("ada"), Idempotency_Key="k").json()["id"] == first


def test_too_many_uploads_at_once_have_to_wait(api: Api) -> None:
    api.context.uploads["bob"] = 2
    is_problem(api.post(**bearer("ada")), 503, "busy")
    api.context.uploads["bob"] = 0
    assert api.post(**bearer("ada")).status_code == 202
    assert api.context.uploads.total() == 0


def test_the_reserve_of_the_disk_is_not_touched(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(10**9, 10**9, 10))
    is_problem(api.post(**bearer("ada")), 507, "no-space")
    is_problem(api.client.get("/readyz"), 503, "starting")
    assert api.client.get("/livez").status_code == 200
    assert api.stored() == []


def test_a_server_that_shuts_down_takes_nothing(api: Api) -> None:
    api.context.draining.set()
    answer = api.post(**bearer("ada"))
    is_problem(answer, 503, "draining")
    assert "retry-after" in answer.headers
    is_problem(api.client.get("/readyz"), 503, "starting")
    assert api.client.get("/livez").status_code == 200


@pytest.mark.parametrize(("number", "status", "code"), [(28, 507, "no-space"), (5, 500, "internal")])
def test_a_disk_that_fails_while_storing_takes_nothing(
    api: Api, monkeypatch: pytest.MonkeyPatch, number: int, status: int, code: str
) -> None:
    """No 202 for what is not on the disk."""

    def full(*a: object, **b: object) -> None:
        raise OSError(number, "No space left on device")

    monkeypatch.setattr(api.context.artifacts, "put", full)
    is_problem(api.post(**bearer("ada")), status, code)
    assert api.context.store.counts() == {}
    assert api.stored() == []


def test_a_disk_that_becomes_full_in_an_upload_is_said_to_be(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    """As an answer like others: after one to a mistake of ours the line is closed, and a next request on it is lost."""
    from service.api import uploads

    def full(self: object, data: bytes) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(uploads.UploadBody, "write", full)
    answer = api.post(**bearer("ada"))
    is_problem(answer, 507, "no-space")
    assert answer.headers["retry-after"]
    assert "connection" not in answer.headers
    assert api.context.store.counts() == {}
    assert api.stored() == []


def test_a_database_that_fails_takes_nothing(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    import sqlalchemy as sa

    def fail(*a: object) -> None:
        raise sa.exc.OperationalError("insert", {}, Exception("disk I/O error"))

    monkeypatch.setattr(api.context.store.queue, "put", fail)
    answer = api.post(**bearer("ada"))
    is_problem(answer, 503, "unavailable")
    assert answer.headers["retry-after"]
    assert api.context.store.counts() == {}
    assert api.stored() == []


def test_without_a_worker_the_server_is_ready(api: Api) -> None:
    """Photos are stored and archives given out; whoever starts workers for waiting jobs needs some to wait."""
    answer = api.client.get("/readyz")
    assert (answer.status_code, answer.json()["workers"]) == (200, 0)


def test_strangers_cannot_list_an_open_server(tmp_path: Path) -> None:
    """Without keys whoever knows an id sees the job; ids cannot be guessed, so they must not be listed either."""
    settings = Settings(data=tmp_path / "data", program=TOY, host="0.0.0.0", reserve_mb=1)  # noqa: S104
    with open_api(settings) as client:
        api = Api(client)
        is_problem(client.get("/v1/avatars"), 403, "listing-needs-key")
        job = api.post(save(picture(300, 300), "PNG")).json()["id"]
        assert client.get(f"/v1/avatars/{job}").status_code == 200


def test_what_comes_through_a_proxy_cannot_list_an_open_server(tmp_path: Path) -> None:
    """The proxy runs here and passes on what strangers ask: an address of this machine says nothing then."""
    settings = Settings(data=tmp_path / "data", program=TOY, reserve_mb=1, allowed_hosts="localhost,avatars.example")
    with open_api(settings) as client:
        assert client.get("/v1/avatars").status_code == 200
        for headers in ({"Host": "avatars.example"}, {"X-Forwarded-For": "192.0.2.7"}, {"Via": "1.1 proxy"}):
            is_problem(client.get("/v1/avatars", headers=headers), 403, "listing-needs-key")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        '{"keys": []}',
        '{"keys": [{"name": "x", "sha256": "short"}]}',
        json.dumps({"keys": [{"sha256": "0" * 64}]}),
        # What could mix tenants up: names that are cut to one, a field misspelt, a number and its text, one key of two.
        json.dumps({"keys": [{**KEYS[name][1], "name": "a" * 64 + name} for name in ("ada", "bob")]}),
        json.dumps({"keys": [{**KEYS["ada"][1], "per_dya": 1}]}),
        json.dumps({"keys": [{**KEYS["ada"][1], "name": 1}, {**KEYS["bob"][1], "name": "1"}]}),
        json.dumps({"keys": [KEYS["ada"][1], {**KEYS["ada"][1], "name": "bob"}]}),
    ],
)
def test_a_file_of_keys_that_is_wrong_stops_the_start(tmp_path: Path, text: str) -> None:
    """An empty file must not open the server to everybody."""
    file = tmp_path / "keys.json"
    file.write_text(text)
    with pytest.raises(UsageError, match="keys"):
        Keys(str(file))
