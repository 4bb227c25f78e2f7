"""The life of a job over HTTP, with a real server, worker and processes."""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator
from io import BytesIO
from typing import Any

import httpx
import pytest

from tests.service.api.conftest import is_problem
from tests.support.server import Server, free_port, in_threads, post, small_photo, wait_for
from tests.support.toy_job import archive

_SEEDS = iter(range(10_000, 20_000))


@pytest.fixture
def photo() -> bytes:
    return small_photo(next(_SEEDS))


@pytest.fixture(scope="module")
def finished(server: Server) -> Iterator[tuple[str, bytes]]:
    """A job that has succeeded, and its archive."""
    picture = small_photo(1)
    with httpx.Client(base_url=server.url, timeout=30) as client:
        job = post(client, picture, seed=4).json()["id"]
        assert wait_for(client, job)["state"] == "succeeded"
    yield job, archive(hashlib.sha256(picture).hexdigest(), 4)


def parse_events(text: str) -> list[dict[str, Any]]:
    """Server-sent events as a browser reads them."""
    events = []
    for block in text.split("\n\n"):
        fields = dict(line.split(": ", 1) for line in block.splitlines() if not line.startswith(":"))
        if "event" in fields:
            events.append({"id": int(fields["id"]), "event": fields["event"], "data": json.loads(fields["data"])})
    return events


def test_from_the_photo_to_the_archive(client: httpx.Client, photo: bytes) -> None:
    accepted = post(client, photo, seed=11)
    assert accepted.status_code == 202
    body = accepted.json()
    assert accepted.headers["location"] == body["links"]["self"] == f"/v1/avatars/{body['id']}"
    assert re.fullmatch(r"[0-9a-f]{32}", body["id"])
    state = wait_for(client, body["id"])
    assert state["state"] == "succeeded"
    assert state["progress"] == 1.0
    assert state["warnings"] == state["warning_words"] == ["toy"], "a code of another version is its own words"
    assert state["options"]["seed"] == 11
    assert state["created_at"] <= state["started_at"] <= state["finished_at"] < state["expires_at"]
    got = client.get(state["links"]["archive"])
    assert got.content == archive(hashlib.sha256(photo).hexdigest(), 11)
    assert got.headers["etag"] == f'"{hashlib.sha256(got.content).hexdigest()}"'
    assert got.headers["content-type"] == "application/zip"


def test_events_tell_every_change_once_and_end(client: httpx.Client, photo: bytes) -> None:
    job = post(client, photo).json()["id"]
    answer = client.get(f"/v1/avatars/{job}/events")  # returns when the server ends the stream
    assert answer.headers["content-type"].startswith("text/event-stream")
    events = parse_events(answer.text)
    assert [event["id"] for event in events] == list(range(1, len(events) + 1))
    assert [event["data"]["state"] for event in events][:1] == ["queued"]
    assert events[-1]["event"] == "state"
    assert events[-1]["data"] == client.get(f"/v1/avatars/{job}").json()
    assert {"one", "two", "three"} <= {event["data"]["stage"] for event in events if event["event"] == "progress"}
    shares = [event["data"]["progress"] for event in events]
    assert shares == sorted(shares)


def test_a_broken_stream_goes_on_where_it_broke(client: httpx.Client, finished: tuple[str, bytes]) -> None:
    address = f"/v1/avatars/{finished[0]}/events"
    whole = parse_events(client.get(address).text)
    rest = parse_events(client.get(address, headers={"Last-Event-ID": "2"}).text)
    assert rest == whole[2:]
    assert client.get(address, headers={"Last-Event-ID": str(whole[-1]["id"])}).status_code == 204
    assert parse_events(client.get(address, headers={"Last-Event-ID": "none of ours"}).text) == whole


@pytest.mark.parametrize(
    ("asked", "start", "end"),
    [
        ("0-0", 0, 1),
        ("0-99", 0, 100),
        ("100-", 100, None),
        ("-7", -7, None),
        ("5-99999999", 5, None),
        ("-99999999", 0, None),
    ],
)
def test_a_download_can_go_on(
    client: httpx.Client, finished: tuple[str, bytes], asked: str, start: int, end: int | None
) -> None:
    job, content = finished
    got = client.get(f"/v1/avatars/{job}/archive.zip", headers={"Range": f"bytes={asked}"})
    assert got.status_code == 206
    assert got.content == content[start:end]
    first = start % len(content)
    assert got.headers["content-range"] == f"bytes {first}-{first + len(got.content) - 1}/{len(content)}"


@pytest.mark.parametrize("asked", ["5-3", "99999999-", "-0", "x", "-", "0-1,3-4", ",".join(["0-1"] * 1000)])
def test_a_range_that_is_not_there_is_refused(client: httpx.Client, finished: tuple[str, bytes], asked: str) -> None:
    job, content = finished
    got = client.get(f"/v1/avatars/{job}/archive.zip", headers={"Range": f"bytes={asked}"})
    is_problem(got, 416, "range-not-satisfiable")
    assert got.headers["content-range"] == f"bytes */{len(content)}"


def test_ranges_and_caches_mind_the_content(client: httpx.Client, finished: tuple[str, bytes]) -> None:
    job, content = finished
    address = f"/v1/avatars/{job}/archive.zip"
    head = client.head(address)
    assert (head.status_code, head.content, int(head.headers["content-length"])) == (200, b"", len(content))
    for asked in ("bytes=0-1", f"bytes={len(content)}-"):
        ranged = client.head(address, headers={"Range": asked})
        assert (ranged.status_code, ranged.headers["content-length"]) == (200, str(len(content))), "ranges are of GET"
        assert "content-range" not in ranged.headers
    etag = head.headers["etag"]
    assert client.get(address, headers={"If-None-Match": etag}).status_code == 304
    assert client.get(address, headers={"Range": "bytes=0-1", "If-Range": etag}).status_code == 206
    other = client.get(address, headers={"Range": "bytes=0-1", "If-Range": '"other"'})
    assert (other.status_code, other.content) == (200, content)


def test_single_files_are_those_of_the_archive(client: httpx.Client, finished: tuple[str, bytes]) -> None:
    job, content = finished
    with zipfile.ZipFile(BytesIO(content)) as zipped:
        members = {name: zipped.read(name) for name in zipped.namelist()}
    items = client.get(f"/v1/avatars/{job}/files").json()["items"]
    assert {item["path"]: item["bytes"] for item in items} == {name: len(data) for name, data in members.items()}
    for item in items:
        got = client.get(item["link"])
        assert got.content == members[item["path"]]
        assert got.headers["content-type"].startswith(item["media_type"])
        assert client.get(item["link"], headers={"Range": "bytes=1-"}).content == members[item["path"]][1:]
    for path in ("nothing", "maps/%2e%2e/manifest.json", "%2e%2e/archive.zip", "maps"):
        is_problem(client.get(f"/v1/avatars/{job}/files/{path}"), 404, "not-found")


def test_the_photo_is_never_given_out(server: Server, client: httpx.Client, photo: bytes) -> None:
    """What was sent may be a page or a script as well; only pictures that were made here leave the server."""
    files: Any = {
        "image": ("photo.html", photo + b"<script>alert(1)</script>", "text/html"),
        "keep_photo": (None, "true"),
    }
    sent = client.post("/v1/avatars", files=files)
    job = sent.json()["id"]
    assert wait_for(client, job)["state"] == "succeeded"
    (kept,) = (server.data / "artifacts" / job).glob("photo-*")
    assert b"<script>" in kept.read_bytes(), "it is there, as was asked for"
    listed = [file["path"] for file in client.get(f"/v1/avatars/{job}/files").json()["items"]]
    assert not [path for path in listed if "photo" in path]
    for path in (kept.name, f"../{kept.name}", "photo", f"..%2f{kept.name}"):
        is_problem(client.get(f"/v1/avatars/{job}/files/{path}"), 404, "not-found")


def test_a_result_that_is_not_there_yet_says_why(client: httpx.Client, photo: bytes) -> None:
    job = post(client, photo, seed=103).json()["id"]
    body = is_problem(client.get(f"/v1/avatars/{job}/archive.zip"), 409, "not-ready")
    assert body["state"] in ("queued", "running")
    assert client.delete(f"/v1/avatars/{job}").status_code == 204
    assert client.get(f"/v1/avatars/{job}").json()["state"] == "cancelled"
    is_problem(client.get(f"/v1/avatars/{job}/archive.zip"), 409, "no-result")


def test_a_job_that_failed_says_why(client: httpx.Client, photo: bytes) -> None:
    job = post(client, photo, seed=104).json()["id"]
    state = wait_for(client, job)
    assert state["state"] == "failed"
    assert state["error"]["code"] == "no-face"
    assert state["error"]["status"] == 422
    assert state["error"]["instance"] == f"/v1/avatars/{job}"
    assert client.get(state["error"]["type"]).status_code == 200


def test_cancelling_frees_the_worker_within_seconds(server: Server, client: httpx.Client, photo: bytes) -> None:
    hanging = [post(client, small_photo(next(_SEEDS)), seed=103).json()["id"] for _ in range(2)]
    for job in hanging:
        while client.get(f"/v1/avatars/{job}").json()["state"] == "queued":
            time.sleep(0.05)
        assert client.delete(f"/v1/avatars/{job}").status_code == 204
    assert wait_for(client, post(client, photo).json()["id"])["state"] == "succeeded"
    for job in hanging:
        assert not any((server.data / "artifacts" / job).glob("*")), "the photo of a cancelled job is erased"


def test_erasing_leaves_nothing_but_the_word_gone(server: Server, client: httpx.Client, photo: bytes) -> None:
    job = post(client, photo).json()["id"]
    wait_for(client, job)
    assert client.delete(f"/v1/avatars/{job}").status_code == 204
    assert client.delete(f"/v1/avatars/{job}").status_code == 204, "twice is once"
    for address in ("", "/archive.zip", "/files", "/events"):
        assert is_problem(client.get(f"/v1/avatars/{job}{address}"), 410, "gone")["reason"] == "erased"
    assert not any((server.data / "artifacts" / job).glob("*"))
    assert job not in client.get("/v1/avatars?limit=100").text


def test_the_same_request_again_is_the_same_job(client: httpx.Client, photo: bytes) -> None:
    key = f"key-{next(_SEEDS)}"
    answers = in_threads(12, lambda number: post(client, photo, 1, key))
    assert {answer.status_code for answer in answers} == {202}
    jobs = {answer.json()["id"] for answer in answers}
    assert len(jobs) == 1
    is_problem(post(client, photo, 2, key), 422, "key-reuse")
    is_problem(post(client, small_photo(next(_SEEDS)), 1, key), 422, "key-reuse")
    job = jobs.pop()
    wait_for(client, job)
    assert post(client, photo, 1, key).json()["id"] == job
    client.delete(f"/v1/avatars/{job}")
    again = post(client, photo, 1, key)
    assert again.status_code == 202, "what was erased may be sent anew"
    assert again.json()["id"] != job


def test_lists_are_paged_newest_first(client: httpx.Client) -> None:
    jobs = [post(client, small_photo(next(_SEEDS))).json()["id"] for _ in range(3)]
    seen: list[str] = []
    address = "/v1/avatars?limit=2"
    while address:
        page = client.get(address)
        seen += [item["id"] for item in page.json()["items"]]
        link = re.match(r'<([^>]+)>; rel="next"', page.headers.get("link", ""))
        address = link[1] if link else ""
        assert (page.json()["next"] is None) == (link is None)
    assert seen[:3] == jobs[::-1]
    assert len(seen) == len(set(seen))
    done = client.get("/v1/avatars?state=succeeded&limit=100").json()["items"]
    assert {item["state"] for item in done} <= {"succeeded"}


def test_what_the_server_says_of_itself(server: Server, client: httpx.Client, finished: tuple[str, bytes]) -> None:
    assert client.get("/livez").json() == {"status": "alive"}
    assert client.get("/readyz").json() == {"status": "ready", "workers": 1}
    models = {item["name"]: item for item in client.get("/v1/models").json()["items"]}
    assert {"face_detector", "face_mesh", "head"} <= set(models)
    assert all(re.fullmatch("[0-9a-f]{64}", model["sha256"]) and model["licence"] for model in models.values())
    quality = client.get("/v1/quality").json()
    assert [level["name"] for level in quality["levels"]] == ["draft", "standard", "high", "reference"]
    assert any(item["jobs"] >= 1 and item["median_s"] > 0 for item in quality["items"])
    assert set(quality["formats"]) >= {"jpeg", "png", "webp"}
    assert all("auto" in names for names in quality["choices"].values())
    metrics = client.get("/metrics").text
    assert re.search(r'^avatarme_jobs{state="succeeded"} [1-9]', metrics, re.MULTILINE)
    assert 'avatarme_workers{ready="true"} 1.0' in metrics
    assert "avatarme_request_seconds_bucket" in metrics
    assert client.get("/").status_code == 200


def test_every_answer_carries_the_guards(client: httpx.Client) -> None:
    for address in ("/", "/livez", "/v1/avatars", "/nothing", "/openapi.json"):
        headers = client.get(address, headers={"X-Request-Id": "abc-1"}).headers
        assert headers["x-request-id"] == "abc-1"
        assert headers["x-content-type-options"] == "nosniff"
        assert "default-src 'none'" in headers["content-security-policy"]
        assert "server" not in headers
    made = client.get("/livez", headers={"X-Request-Id": "a b\u007f"}).headers["x-request-id"]
    assert re.fullmatch("[0-9a-f]{16}", made)


def test_the_page_is_asked_for_anew_each_time(client: httpx.Client) -> None:
    """A browser that kept an old page would speak to a new server with it."""
    for address in ("/", "/app.js", "/app.css"):
        answer = client.get(address)
        assert answer.headers["cache-control"] == "no-cache"
        again = client.get(address, headers={"If-None-Match": answer.headers["etag"]})
        assert (again.status_code, again.headers["cache-control"]) == (304, "no-cache")


def test_the_log_has_one_line_of_json_for_a_request_and_nothing_private(server: Server, client: httpx.Client) -> None:
    client.post(
        "/v1/avatars",
        files={"image": ("my-secret-name.jpg", small_photo(2))},
        headers={"X-Request-Id": "log-1", "Authorization": "Bearer my-secret-key"},
    )
    time.sleep(0.2)
    lines = [json.loads(line) for line in server.log.read_text().splitlines() if '"log-1"' in line]
    assert len(lines) == 1
    assert lines[0]["status"] == 202
    assert {"time", "level", "route", "seconds", "bytes_in"} <= set(lines[0])
    assert "my-secret" not in server.log.read_text()


def test_the_answers_are_those_of_the_description(client: httpx.Client, finished: tuple[str, bytes]) -> None:
    import jsonschema

    described = client.get("/openapi.json").json()
    schema = {"$ref": "#/components/schemas/Job", "components": described["components"]}
    jsonschema.validate(client.get(f"/v1/avatars/{finished[0]}").json(), schema)
    page = {"$ref": "#/components/schemas/JobPage", "components": described["components"]}
    jsonschema.validate(client.get("/v1/avatars").json(), page)
    files = client.get(f"/v1/avatars/{finished[0]}/files").json()["items"]
    archive = f"/v1/avatars/{finished[0]}/archive.zip"
    for path, addresses in (("archive.zip", [archive]), ("files/{path}", [file["link"] for file in files])):
        kinds = described["paths"][f"/v1/avatars/{{job}}/{path}"]["get"]["responses"]["200"]["content"]
        for address in addresses:
            assert client.get(address).headers["content-type"].partition(";")[0] in kinds


def test_a_second_server_on_the_folder_refuses_to_start(server: Server) -> None:
    """Two would run every job twice."""
    command = [sys.executable, "-m", "service", "serve", "--no-worker", "--data", str(server.data)]
    second = subprocess.run(
        [*command, "--port", str(free_port())], check=False, capture_output=True, text=True, timeout=120
    )
    assert second.returncode == 2
    assert "in use" in second.stderr
