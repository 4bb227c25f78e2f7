"""What is asked for is done or refused, never passed over: parameters, methods, kinds of values, forms of addresses."""

from __future__ import annotations

import socket
from typing import Any

import pytest

from tests.service.api.conftest import GOOD, Api, is_problem
from tests.support.server import Server, small_photo

RAW = {"Content-Type": "image/jpeg"}


@pytest.mark.parametrize(
    ("path", "allowed"),
    [
        ("/v1/avatars", {"GET", "HEAD", "POST"}),
        ("/v1/avatars/" + "0" * 32, {"GET", "HEAD", "DELETE"}),
        ("/v1/avatars/" + "0" * 32 + "/events", {"GET", "HEAD"}),
        ("/v1/avatars/" + "0" * 32 + "/archive.zip", {"GET", "HEAD"}),
        ("/livez", {"GET", "HEAD"}),
    ],
)
def test_allow_names_the_methods_of_all_routes(shared: Api, path: str, allowed: set[str]) -> None:
    answer = shared.client.request("PUT", path)
    is_problem(answer, 405, "method-not-allowed")
    assert set(answer.headers["allow"].split(", ")) == allowed


@pytest.mark.parametrize("path", ["/livez", "/readyz", "/metrics", "/v1/avatars", "/openapi.json", "/v1/quality"])
def test_head_is_get_without_its_body(shared: Api, path: str) -> None:
    head, get = shared.client.head(path), shared.client.get(path)
    assert (head.status_code, head.content) == (get.status_code, b"")
    assert head.headers["content-type"] == get.headers["content-type"]


@pytest.mark.parametrize(
    "path", ["/v1/avatars?quality=draft", "/v1/avatars/" + "0" * 32 + "?verbose=1", "/v1/models?name=a"]
)
def test_a_parameter_that_there_is_not_is_refused(shared: Api, path: str) -> None:
    answer = shared.client.get(path)
    body = is_problem(answer, 422, "invalid-parameter")
    assert body["pointer"].startswith("/query/")


def test_a_photo_as_the_body_has_its_options_in_the_address(shared: Api) -> None:
    query = "quality=draft&size=576x384&seed=7&maps=texture,confidence&face=largest&keep_photo=true&priority=low"
    answer = shared.client.post(f"/v1/avatars?{query}", content=GOOD, headers=RAW)
    assert answer.status_code == 202, answer.text
    job = answer.json()
    wanted = {"quality": "draft", "size": [576, 384], "seed": 7, "maps": ["texture", "confidence"], "face": "largest"}
    assert {name: job["options"][name] for name in wanted} == wanted
    assert job["priority"] == "low"
    assert job["links"]["photo"]


@pytest.mark.parametrize("kind", ["image/jpeg", "image/png", "image/webp", "image/heic", "image/heif"])
def test_a_photo_as_the_body_may_be_of_every_type_that_is_read(shared: Api, kind: str) -> None:
    """A body that is a HEIC photo was refused for its type, though forms with one were taken."""
    answer = shared.client.post("/v1/avatars", content=GOOD, headers={"Content-Type": kind})
    assert answer.status_code == 202, answer.text


@pytest.mark.parametrize("path", ["/v1/avatars?limit=1&limit=2", "/v1/avatars?state=failed&limit=1&state=queued"])
def test_a_parameter_that_is_there_twice_is_refused(shared: Api, path: str) -> None:
    assert "more than once" in is_problem(shared.client.get(path), 422, "invalid-parameter")["detail"]


def test_an_option_of_a_photo_that_is_there_twice_is_refused(shared: Api) -> None:
    answer = shared.client.post("/v1/avatars?quality=draft&quality=high", content=GOOD, headers=RAW)
    assert is_problem(answer, 422, "invalid-parameter")["pointer"] == "/query/quality"


def test_a_form_has_no_options_in_its_address(shared: Api) -> None:
    answer = shared.client.post("/v1/avatars?quality=draft", files={"image": ("x.jpg", GOOD, "image/jpeg")})
    is_problem(answer, 422, "invalid-parameter")


def test_sizes_are_written_as_on_the_command_line_too(shared: Api) -> None:
    assert shared.post(options={"size": "1152x768"}).json()["options"]["size"] == [1152, 768]
    assert shared.post(options={"size": [1152, 768]}).json()["options"]["size"] == [1152, 768]


def test_a_photo_that_was_to_be_kept_is_given_back_to_its_owner(shared: Api) -> None:
    files: dict[str, Any] = {"image": ("x.jpg", GOOD, "image/jpeg"), "keep_photo": (None, "true")}
    job = shared.client.post("/v1/avatars", files=files).json()
    answer = shared.client.get(job["links"]["photo"])
    assert answer.content == GOOD
    assert answer.headers["content-type"] == "application/octet-stream"
    assert answer.headers["content-disposition"].startswith("attachment")
    other = shared.post().json()
    assert other["links"]["photo"] is None
    is_problem(shared.client.get(f"{other['links']['self']}/photo"), 404, "not-found")


@pytest.mark.parametrize(
    ("text", "code"),
    [("[1]", "malformed-metadata"), ("{", "malformed-metadata"), ('{"a": "%s"}' % ("x" * 2048), "usage")],
)
def test_metadata_have_a_form_and_a_size(shared: Api, text: str, code: str) -> None:
    files: dict[str, Any] = {"image": ("x.jpg", GOOD, "image/jpeg"), "metadata": (None, text)}
    is_problem(shared.client.post("/v1/avatars", files=files), 422, code)


def test_an_address_with_scheme_and_host_is_understood(server: Server) -> None:
    def status(target: str, host: str) -> bytes:
        with socket.create_connection(("127.0.0.1", server.port), timeout=10) as line:
            line.sendall(f"GET {target} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n".encode())
            return line.makefile("rb").readline().split()[1]

    assert status(f"http://127.0.0.1:{server.port}/v1/avatars?limit=1", "127.0.0.1") == b"200"
    assert status(f"http://localhost:{server.port}/livez", "other.example") == b"200", "the Host header is ignored then"
    assert status("http://evil.example/livez", "localhost") == b"400"


def test_a_page_of_another_origin_changes_nothing(shared: Api) -> None:
    before = len(shared.stored())
    foreign: tuple[dict[str, str], ...] = (
        {"Origin": "http://evil.example"}, {"Origin": "null"}, {"Origin": "http://localhost:81"},
        {"Sec-Fetch-Site": "cross-site"}, {"Sec-Fetch-Site": "same-site"},
        {"Sec-Fetch-Site": "cross-site", "Origin": "http://localhost"},
    )  # fmt: skip
    for headers in foreign:
        files = {"image": ("x.jpg", small_photo(5), "image/jpeg")}
        is_problem(shared.client.post("/v1/avatars", files=files, headers=headers), 403, "cross-origin")
        is_problem(shared.client.delete("/v1/avatars/" + "0" * 32, headers=headers), 403, "cross-origin")
    assert len(shared.stored()) == before


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"Origin": "http://localhost"},
        {"Origin": "https://localhost"},
        {"Sec-Fetch-Site": "same-origin", "Origin": "https://name.of.a.proxy"},
        {"Sec-Fetch-Site": "none"},
    ],
)
def test_the_own_page_and_programs_are_let_in(shared: Api, headers: dict[str, str]) -> None:
    files = {"image": ("x.jpg", GOOD, "image/jpeg")}
    assert shared.client.post("/v1/avatars", files=files, headers=headers).status_code == 202
