"""Two tenants at a real server, one of whom means no good: what the other one has of it."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import json
import os
import socket
import stat
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.api.keys import new_key
from service.client.client import Client
from service.client.errors import AccessDenied
from service.errors import UsageError
from service.jobs.webhooks import resolved, target
from tests.service.api.conftest import TOY_PICTURE, is_problem
from tests.support.server import Server, small_photo, wait_for

KEYS = {name: new_key(name) for name in ("ada", "bob", "eve")}
HALF = "\ud800"
"""The first half of a surrogate pair."""

_SEEDS = iter(range(50_000, 60_000))


def as_tenant(server: Server, name: str, timeout: float = 60.0) -> httpx.Client:
    headers = {"Authorization": f"Bearer {KEYS[name][0]}"}
    return httpx.Client(base_url=server.url, headers=headers, timeout=timeout)


def write_keys(file: Path, *names: str, **more: Any) -> None:
    replaced = file.with_suffix(".new")
    replaced.write_text(json.dumps({"keys": [{**KEYS[name][1], **more.get(name, {})} for name in names]}))
    replaced.replace(file)


def settings_of(keys: Path) -> dict[str, Any]:
    return {"keys": keys, "archive_program": TOY_PICTURE, "idle_seconds": 3.0, "jobs": 2}


class Receiver:
    """Takes messages as ``kind`` says: "good" at once, "silent" never, "dripping" with a header that has no end."""

    def __init__(self, kind: str) -> None:
        self.kind, self.got = kind, list[bytes]()
        self._socket = socket.create_server(("127.0.0.1", 0), backlog=64)
        self.host = f"127.0.0.1:{self._socket.getsockname()[1]}"
        self._open: list[socket.socket] = []
        threading.Thread(target=self._take, daemon=True).start()

    def _take(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                line = self._socket.accept()[0]
                self._open.append(line)
                threading.Thread(target=self._answer, args=(line,), daemon=True).start()

    def _answer(self, line: socket.socket) -> None:
        with contextlib.suppress(OSError):
            if self.kind == "silent":
                return
            self.got.append(line.recv(1 << 16))
            if self.kind == "good":
                line.sendall(b"HTTP/1.1 204 No Content\r\nContent-Length: 0\r\n\r\n")
                line.close()
                return
            line.sendall(b"HTTP/1.1 200 OK\r\nX-Slow: ")
            while True:
                line.sendall(b"x")
                time.sleep(0.5)

    def close(self) -> None:
        for line in (self._socket, *self._open):
            line.close()


@pytest.fixture(scope="module")
def receivers() -> Iterator[dict[str, Receiver]]:
    made = {kind: Receiver(kind) for kind in ("good", "silent", "dripping")}
    yield made
    for receiver in made.values():
        receiver.close()


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, receivers: dict[str, Receiver]) -> Iterator[Server]:
    """With webhooks to the receivers; started where others may read everything, on a folder that has files already."""
    folder = tmp_path_factory.mktemp("strangers")
    write_keys(folder / "keys.json", "ada", "bob")
    (folder / "secret").write_text("whsec_" + base64.b64encode(b"s" * 24).decode())
    hosts = ",".join(receiver.host for receiver in receivers.values())
    webhooks = {"webhook_hosts": hosts, "webhook_secret": folder / "secret", "webhook_private": True}
    (folder / "data").mkdir(mode=0o755)
    (folder / "data" / "old.txt").write_text("old")
    (folder / "data" / "jobs.sqlite").touch(0o644)
    running = Server(folder / "data", settings_of(folder / "keys.json") | webhooks)
    before = os.umask(0)
    try:
        running.start()
    finally:
        os.umask(before)
    yield running
    running.stop()


@pytest.fixture(scope="module")
def idle(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """Without a worker, so jobs wait, and streams of events stay open; the last test that uses it ends it."""
    folder = tmp_path_factory.mktemp("idle")
    write_keys(folder / "keys.json", "ada", "bob", "eve", eve={"per_day": 3})
    running = Server(folder / "data", settings_of(folder / "keys.json") | {"notice_seconds": 1.5}, with_worker=False)
    running.start(ready=False)
    yield running
    running.stop()


@pytest.fixture
def ada(server: Server) -> Iterator[httpx.Client]:
    with as_tenant(server, "ada") as client:
        yield client


@pytest.fixture
def bob(server: Server) -> Iterator[httpx.Client]:
    with as_tenant(server, "bob") as client:
        yield client


def send(client: httpx.Client, photo: bytes | None = None, headers: Any = None, **parts: str) -> httpx.Response:
    files: dict[str, Any] = {"image": ("x.jpg", photo or small_photo(next(_SEEDS)))}
    files |= {name: (None, text.encode("ascii")) for name, text in parts.items()}
    return client.post("/v1/avatars", files=files, headers=headers)


def seconds_of(client: httpx.Client, times: int = 3) -> list[float]:
    """How long a tenant's posts take that are accepted."""
    taken = []
    for _ in range(times):
        photo, begin = small_photo(next(_SEEDS)), time.monotonic()
        answer = send(client, photo)
        taken.append(time.monotonic() - begin)
        assert answer.status_code == 202, answer.text
    return taken


# 1. Text that is no text.


def test_half_a_character_in_an_id_or_a_cursor_is_refused(ada: httpx.Client) -> None:
    for place, more in (("renders", {}), ("exports", {"for": "blender"})):
        body = json.dumps({"avatar": HALF + "0" * 31, **more})
        answer = ada.post(f"/v1/{place}", content=body, headers={"Content-Type": "application/json"})
        is_problem(answer, 422, f"malformed-{place.removesuffix('s')}")
    job = "0" * 32
    for content in ([1.5, HALF + job[1:]], [float("nan"), job], [float("inf"), job], [1.5, "x"], [10**90, 1]):
        cursor = base64.urlsafe_b64encode(json.dumps(content).encode()).decode()
        is_problem(ada.get("/v1/avatars", params={"cursor": cursor}), 422, "invalid-parameter")


# 2. Places for uploads.


def drip(server: Server, name: str, until: threading.Event) -> bytes:
    """An upload of one byte every half second; what the server says in the end."""
    head = f"POST /v1/avatars HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {KEYS[name][0]}\r\n"
    head += "Content-Type: image/jpeg\r\nContent-Length: 100000\r\n\r\n"
    with socket.create_connection(("127.0.0.1", server.port)) as line:
        line.sendall(head.encode())
        line.settimeout(0.5)
        while not until.is_set():
            try:
                return line.recv(4096)
            except TimeoutError:
                with contextlib.suppress(OSError):
                    line.sendall(b"\xff")
    return b""


def test_slow_uploads_of_one_tenant_leave_places_to_the_others(server: Server, bob: httpx.Client) -> None:
    alone = max(seconds_of(bob))
    until, answers = threading.Event(), []
    threads = [threading.Thread(target=lambda: answers.append(drip(server, "ada", until))) for _ in range(64)]
    for thread in threads:
        thread.start()
    time.sleep(1.0)
    taken = seconds_of(bob, 10)
    for thread in threads:
        thread.join(20)
    until.set()
    assert max(taken) <= max(1.0, 2 * alone)
    states = [int(answer.split()[1]) for answer in answers]
    assert set(states) == {408, 503}, "too slow after the first seconds, or never let in"
    assert states.count(408) >= 16


# 3. Webhooks.


def test_one_bad_receiver_stops_nobody_elses_messages(
    receivers: dict[str, Receiver], ada: httpx.Client, bob: httpx.Client
) -> None:
    for number in range(16):
        kind = ("silent", "dripping")[number % 2]
        assert send(ada, webhook_url=f"http://{receivers[kind].host}/x").status_code == 202
    deadline, good = time.monotonic() + 60, receivers["good"]
    while ada.get("/v1/avatars?state=succeeded").json()["items"][15:] == [] and time.monotonic() < deadline:
        time.sleep(0.1)
    before = len(good.got)
    wait_for(bob, send(bob, webhook_url=f"http://{good.host}/x").json()["id"])
    begin = time.monotonic()
    while len(good.got) == before and time.monotonic() - begin < 60:
        time.sleep(0.05)
    assert len(good.got) > before and time.monotonic() - begin < 5


# 4. Decoding, and keys that are not known.


def test_a_client_learns_of_a_wrong_key_before_it_sends_anything(idle: Server) -> None:
    with Client(idle.url, api_key=KEYS["ada"][0]) as known, Client(idle.url, api_key="wrong") as unknown:
        known.ready()
        with pytest.raises(AccessDenied):
            unknown.ready()


def test_photos_that_are_refused_count_in_the_quota_of_a_day(idle: Server) -> None:
    damaged = small_photo(1)[:-200]
    with as_tenant(idle, "eve") as eve, as_tenant(idle, "bob") as bob:
        for _ in range(2):
            is_problem(send(eve, damaged), 422, "corrupt-image")
        assert send(eve).status_code == 202
        is_problem(send(eve, damaged), 429, "quota")
        is_problem(send(bob, damaged), 422, "corrupt-image")
        assert send(bob).status_code == 202


# 5. Files of the data folder.


def test_what_the_server_writes_is_its_own(server: Server, ada: httpx.Client) -> None:
    """Whatever the umask is, and whatever was there."""
    job = send(ada, keep_photo="true").json()["id"]
    assert wait_for(ada, job)["state"] == "succeeded"
    modes = {path: stat.S_IMODE(path.lstat().st_mode) for path in (server.data, *server.data.rglob("*"))}
    assert {path.name for path in modes} >= {"jobs.sqlite", "jobs.sqlite-wal", "old.txt", "artifacts"}
    assert not {str(path): oct(mode) for path, mode in modes.items() if mode & 0o077}


# 6. What is taken at the door.


def test_a_key_belongs_to_one_request_with_all_of_its_parts(ada: httpx.Client, bob: httpx.Client) -> None:
    photo, key = small_photo(next(_SEEDS)), {"Idempotency-Key": "again"}
    job = send(ada, photo, key).json()["id"]
    assert send(ada, photo, key).json()["id"] == job
    is_problem(send(ada, photo, key, priority="low"), 422, "key-reuse")
    assert send(bob, photo, key, priority="low").json()["id"] != job


def test_a_stream_of_events_ends_with_its_key(idle: Server) -> None:
    begun, ended = dict[str, float](), dict[str, float]()

    def follow(name: str) -> None:
        with as_tenant(idle, name) as client, contextlib.suppress(httpx.HTTPError):
            job = send(client).json()["id"]
            with client.stream("GET", f"/v1/avatars/{job}/events") as stream:
                for _ in stream.iter_lines():
                    begun.setdefault(name, time.monotonic())
        ended[name] = time.monotonic()

    for name in ("ada", "bob"):
        threading.Thread(target=follow, args=(name,), daemon=True).start()
    while len(begun) < 2:
        time.sleep(0.05)
    assert not ended
    begin = time.monotonic()
    write_keys(idle.data.with_name("keys.json"), "bob")
    while "ada" not in ended and time.monotonic() - begin < 10:
        time.sleep(0.05)
    assert ended["ada"] - begin < 5
    assert "bob" not in ended


def test_what_was_downloaded_is_asked_for_again(ada: httpx.Client, bob: httpx.Client) -> None:
    """Erased means erased, in the browser's own store too."""
    job = send(ada, keep_photo="true").json()["id"]
    assert wait_for(ada, job)["state"] == "succeeded"
    for path, wanted in (("photo", "no-store"), ("archive.zip", "no-cache"), ("files/manifest.json", "no-cache")):
        answer = ada.get(f"/v1/avatars/{job}/{path}")
        assert answer.status_code == 200 and wanted in answer.headers["cache-control"], path
        is_problem(bob.get(f"/v1/avatars/{job}/{path}"), 404, "not-found")


# 7. Addresses of webhooks.


@pytest.mark.parametrize(
    "address",
    [
        "64:ff9b::7f00:1", "2002:7f00:1::", "2002:7fff::1", "::127.0.0.1", "::10.0.0.1", "::ffff:10.0.0.1", "fec0::1",
        "ff02::1", "224.0.0.1", "fe80::1", "fc00::1", "::", "::1", "0.0.0.1", "169.254.169.254", "100.64.0.1",
    ],
)  # fmt: skip
def test_a_listed_name_that_leads_inside_is_not_told(monkeypatch: pytest.MonkeyPatch, address: str) -> None:
    kind = socket.AF_INET6 if ":" in address else socket.AF_INET
    monkeypatch.setattr(socket, "getaddrinfo", lambda *a, **b: [(kind, socket.SOCK_STREAM, 6, "", (address, 443))])
    with pytest.raises(UsageError, match=r"leads to hooks\.example, .* has to be of the open internet"):
        resolved(target("https://hooks.example/x", "hooks.example", private=False), private=False)


# Erasing.


def test_of_what_was_erased_no_byte_is_left(
    server: Server, receivers: dict[str, Receiver], ada: httpx.Client, bob: httpx.Client
) -> None:
    """In files, database, its log of writes, and the log of the server."""
    photos, clients, good = {name: small_photo(next(_SEEDS)) for name in ("ada", "bob")}, [ada, bob], receivers["good"]
    jobs, told = {}, len(good.got)
    for (name, photo), client in zip(photos.items(), clients, strict=True):
        parts = {"metadata": json.dumps({"who": f"{name}-metadata"}), "keep_photo": "true"}
        parts["webhook_url"] = f"http://{good.host}/{name}-webhook"
        jobs[name] = send(client, photo, {"Idempotency-Key": f"{name}-repeats"}, **parts).json()["id"]
        assert wait_for(client, jobs[name])["state"] == "succeeded"
        assert client.post("/v1/renders", json={"avatar": jobs[name], "view": "front"}).status_code == 200
    deadline = time.monotonic() + 20
    while len(good.got) < told + 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    assert ada.delete(f"/v1/avatars/{jobs['ada']}").status_code == 204
    deadline = time.monotonic() + 20  # until the worker has swept, and folded the log of writes
    while where(written(server), photos["ada"], "ada") and time.monotonic() < deadline:
        time.sleep(0.3)
    found = {name: where(written(server), photo, name) for name, photo in photos.items()}
    assert len(found["bob"]) >= 4, "what is searched for can be found"
    assert found["ada"] == {}


def written(server: Server) -> dict[Path, bytes]:
    """What lies on the disk of a server now."""
    found = {}
    for path in (*server.data.rglob("*"), server.log):
        with contextlib.suppress(OSError):  # a folder, or gone meanwhile
            found[path] = path.read_bytes()
    return found


def where(everything: dict[Path, bytes], photo: bytes, name: str) -> dict[str, list[str]]:
    """Files that hold something of a tenant's request."""
    middle = len(photo) // 2
    traces = {
        "photo": photo[middle : middle + 48], "hash": hashlib.sha256(photo).hexdigest().encode(),
        "metadata": f"{name}-metadata".encode(), "webhook": f"{name}-webhook".encode(),
        "key": f"{name}-repeats".encode(), "secret": KEYS[name][0].encode(),
    }  # fmt: skip
    found = {what: [path.name for path, data in everything.items() if trace in data] for what, trace in traces.items()}
    return {what: names for what, names in found.items() if names}


def test_readiness_ends_before_the_server_does(idle: Server) -> None:
    assert idle.process is not None
    assert httpx.get(f"{idle.url}/readyz").status_code == 200
    idle.process.terminate()
    time.sleep(0.4)
    is_problem(httpx.get(f"{idle.url}/readyz"), 503, "starting")
    assert httpx.get(f"{idle.url}/livez").status_code == 200
    assert idle.process.wait(30) == 0
