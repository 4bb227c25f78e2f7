"""What strangers send, and the right answer to each."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import pytest

from service.jobs.settings import Settings
from tests.service.api.conftest import GOOD, TOY, Api, is_problem, open_api
from tests.service.photo import badimages as bad

RGB = bad.picture(300, 280)

REFUSED: dict[str, tuple[Callable[[], bytes], int, str]] = {
    "zero bytes": (lambda: b"", 422, "empty-file"),
    "cut jpeg": (lambda: GOOD[: len(GOOD) // 2], 422, "corrupt-image"),
    "cut png": (lambda: bad.save(RGB, "PNG")[:-300], 422, "corrupt-image"),
    "65500 x 65500": (lambda: bad.jpeg_header(65500, 65500), 422, "too-many-pixels"),
    "png bomb": (lambda: bad.png_bomb(), 422, "too-many-pixels"),
    "profile bomb": (lambda: bad.text_bomb(b"iCCP"), 422, "corrupt-image"),
    "600 scans": (lambda: bad.many_scans(600), 422, "too-complex"),
    "1 x 1": (lambda: bad.save(RGB[:1, :1], "PNG"), 422, "too-small"),
    "32 x 32": (lambda: bad.save(RGB[:32, :32], "PNG"), 422, "too-small"),
    "20000 x 10": (lambda: bad.png_header(20000, 10), 422, "bad-aspect"),
    "4000 x 100": (lambda: bad.png_header(4000, 100), 422, "bad-aspect"),
    "animated webp": (lambda: bad.webp_animation(), 422, "animated"),
    "animated png": (lambda: bad.apng(3), 422, "animated"),
    "svg": (lambda: bad.NOT_IMAGES["svg"], 415, "unsupported-format"),
    "postscript": (lambda: bad.NOT_IMAGES["postscript"], 415, "unsupported-format"),
    "too many bytes": (lambda: b"\xff\xd8\xff" + bytes(25 << 20), 413, "too-large"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_photo_that_cannot_be_used_is_refused_and_not_kept(shared: Api, name: str) -> None:
    make, status, code = REFUSED[name]
    before = shared.stored()
    is_problem(shared.post(make()), status, code)
    assert shared.stored() == before


@pytest.mark.parametrize("kind", ["text/plain", "application/octet-stream", "image/gif", "x"])
def test_the_type_that_a_part_claims_does_not_matter(shared: Api, kind: str) -> None:
    assert shared.post(kind=kind).status_code == 202


@pytest.mark.parametrize(
    "name", ["../../etc/passwd", "a\0b", "x" * 5000, "\u202egpj.exe", "CON", 'a"; name="options', "<script>", ""]
)
def test_the_name_of_a_file_does_not_matter_and_comes_back_nowhere(shared: Api, name: str) -> None:
    answer = shared.post(name=name or "x")
    assert answer.status_code in (202, 400), answer.text
    if name:
        assert name not in answer.text
    for path in shared.stored():
        assert path.is_relative_to(shared.context.settings.data)


def raw(shared: Api, body: bytes, kind: str = "multipart/form-data; boundary=b") -> httpx2.Response:
    return shared.client.post("/v1/avatars", content=body, headers={"Content-Type": kind})


def part(name: str, content: bytes, extra: str = "") -> bytes:
    return f'--b\r\nContent-Disposition: form-data; name="{name}"{extra}\r\n\r\n'.encode() + content + b"\r\n"


END = b"--b--\r\n"
FORM = "multipart/form-data; boundary=b"
FILE = '; filename="photo.jpg"'
HALF = b'{"a": [{"b": "x\\ud800y"}]}'
"""The first half of a surrogate pair: JSON can write it, and nothing can encode it."""


BODIES: dict[str, tuple[bytes, str, int, str]] = {
    "no body": (b"", FORM, 400, "missing-file"),
    "no photo": (part("options", b"{}") + END, FORM, 400, "missing-file"),
    "no image": (b"", "image/jpeg", 400, "missing-file"),
    "json": (GOOD, "application/json", 415, "unsupported-media-type"),
    "no type": (GOOD, "", 415, "unsupported-media-type"),
    "no name": (b"--b\r\nContent-Disposition: form-data\r\n\r\nx\r\n" + END, FORM, 400, "malformed-multipart"),
    "half a character": (part("image", GOOD) + part("metadata", HALF) + END, FORM, 422, "malformed-metadata"),
    "no boundary": (GOOD, "multipart/form-data", 400, "malformed-multipart"),
    "empty boundary": (GOOD, "multipart/form-data; boundary=", 400, "malformed-multipart"),
    "other boundary": (part("image", GOOD) + END, "multipart/form-data; boundary=o", 400, "malformed-multipart"),
    "no end": (part("image", GOOD), FORM, 400, "malformed-multipart"),
    "cut off": (part("image", GOOD)[:-500], FORM, 400, "malformed-multipart"),
    "two photos, one of them none": (part("image", GOOD) + part("image", b"?") + END, FORM, 415, "unsupported-format"),
    "a photo for a video": (part("image", GOOD) + part("video", GOOD) + END, FORM, 415, "unsupported-format"),
    "25 photos": (part("image", GOOD) * 25 + END, FORM, 400, "too-many-files"),
    "parts twice": (part("image", GOOD) + part("options", b"{}") * 2 + END, FORM, 400, "too-many-parts"),
    "2 MB of text": (part("image", GOOD) + part("options", b" " * 2_000_000) + END, FORM, 400, "part-too-large"),
    "2 MB of text in a strange part": (part("x", b" " * 2_000_000) + END, FORM, 400, "part-too-large"),
    "1500 parts": (b"".join(part(f"x{n}", b"1") for n in range(1500)) + END, FORM, 400, "too-many-parts"),
    "1500 photos": (part("image", GOOD) * 1500 + END, FORM, 400, "too-many-files"),
    "two photos of two names": (part("image", GOOD) + part("b", GOOD, FILE) + END, FORM, 400, "too-many-files"),
    "two photos, the strange one first": (
        part("b", GOOD * 40, FILE) + part("image", GOOD, FILE) + END,
        FORM,
        400,
        "too-many-files",
    ),
    "a photo of another name": (part("b", GOOD * 40, FILE) + END, FORM, 422, "unknown-field"),
    "a giant of another name": (part("b", bytes(26 << 20), FILE) + END, FORM, 413, "too-large"),
    "half a wish and nine parts": (
        part("keep_photo", b"maybe") + b"".join(part(f"x{n}", b"1") for n in range(8)) + END,
        FORM,
        400,
        "too-many-parts",
    ),
    "half a wish, cut off": (part("image", GOOD) + part("keep_photo", b"maybe"), FORM, 400, "malformed-multipart"),
    "part image_url": (part("image_url", b"http://localhost/") + END, FORM, 422, "unknown-field"),
    "long head of a part": (part("image", GOOD, "; x=" + "y" * 9000) + END, FORM, 400, "malformed-multipart"),
    "half a wish": (part("image", GOOD) + part("keep_photo", b"maybe") + END, FORM, 422, "usage"),
}


@pytest.mark.parametrize("name", BODIES)
def test_a_body_that_is_not_as_announced_is_refused(shared: Api, name: str) -> None:
    body, kind, status, code = BODIES[name]
    before = shared.stored()
    is_problem(raw(shared, body, kind), status, code)
    assert shared.stored() == before, "nothing of a refused request may stay on the disk"


def test_a_file_that_is_no_video_is_told_which_videos_are_read(shared: Api) -> None:
    body = is_problem(raw(shared, part("video", b"RIFF....AVI LIST") + END), 415, "unsupported-format")
    assert body["detail"] == "the part 'video' is no video that is read: MP4, QuickTime and WebM are"


def test_an_option_as_a_part_is_told_where_options_belong(shared: Api) -> None:
    body = is_problem(raw(shared, part("image", GOOD) + part("quality", b"draft") + END), 422, "unknown-field")
    assert "put quality into the JSON object 'options'" in body["detail"]
    assert "put x" not in is_problem(raw(shared, part("x", b"1") + END), 422, "unknown-field")["detail"]


def test_a_body_in_another_coding_is_refused(shared: Api) -> None:
    headers = {"Content-Type": "image/jpeg", "Content-Encoding": "gzip"}
    answer = shared.client.post("/v1/avatars", content=b"x", headers=headers)
    is_problem(answer, 415, "unsupported-media-type")
    assert answer.headers["accept-encoding"] == "identity"


@pytest.mark.parametrize(
    ("options", "status", "code", "pointer"),
    [
        pytest.param('{"seed": NaN}', 422, "malformed-options", "", id="nan"),
        pytest.param('{"budget": 1e309}', 422, "malformed-options", "", id="1e309"),
        pytest.param("[1]", 422, "malformed-options", "", id="a list"),
        pytest.param("{", 422, "malformed-options", "", id="half an object"),
        pytest.param("[" * 15_000, 422, "malformed-options", "", id="deep"),
        pytest.param('{"seed":' + "[" * 50 + "]" * 50 + "}", 422, "malformed-options", "", id="deeper"),
        pytest.param('{"a/b~": [0, -Infinity]}', 422, "malformed-options", "", id="-inf"),
        pytest.param('{"seed": -1}', 422, "usage", "/seed", id="negative"),
        pytest.param('{"iterations": 1' + "0" * 400 + "}", 422, "malformed-options", "", id="400 digits"),
        pytest.param('{"seed": true}', 422, "usage", "/seed", id="true"),
        pytest.param('{"\\ud800": "a"}', 422, "malformed-options", "", id="half a character"),
        pytest.param('{"face": "/x"}', 422, "usage", "/face", id="a path"),
        pytest.param('{"seed": 1e30}', 422, "usage", "/seed", id="huge"),
        pytest.param('{"seed": "x"}', 422, "usage", "/seed", id="a word"),
        pytest.param('{"size": [1, 2, 3]}', 422, "usage", "/size", id="three sides"),
        pytest.param('{"size": [600, 600]}', 422, "usage", "/size", id="a square"),
        pytest.param('{"maps": ["nothing"]}', 422, "usage", "/maps", id="no such map"),
        pytest.param('{"url": "http://169.254.169.254/"}', 422, "unknown-field", "/url", id="url"),
        pytest.param('{"image_url": "file:///etc/passwd"}', 422, "unknown-field", "/image_url", id="image_url"),
        pytest.param('{"\\u202e": 1}', 422, "unknown-field", "/\u202e", id="bidi"),
    ],
)
def test_options_that_cannot_be_are_named(shared: Api, options: str, status: int, code: str, pointer: str) -> None:
    body = is_problem(shared.post(options=options), status, code)
    assert body["pointer"].startswith(pointer)


@pytest.mark.parametrize(
    "job",
    ["x", "0" * 32, "..%2f..%2fetc%2fpasswd", "%00", "A" * 5000, "0" * 32 + "/archive.zip", "0" * 32 + "/files/x"],
)
def test_what_is_not_there_is_not_there(shared: Api, job: str) -> None:
    is_problem(shared.client.get(f"/v1/avatars/{job}"), 404, "not-found")


@pytest.mark.parametrize("path", ["/nothing", "/v1", "/v1/avatars/", "/.git/config", "/docs", "/../pyproject.toml"])
def test_unknown_addresses_are_problems_too(shared: Api, path: str) -> None:
    is_problem(shared.client.get(path), 404, "not-found")


@pytest.mark.parametrize(
    "host", ["evil.example", "localhost.evil.example", "", "a b", "[::1", "127.0.0.1.evil.example"]
)
def test_another_host_name_is_refused(shared: Api, host: str) -> None:
    """A page that points a name of its own at this server (DNS rebinding) must not get in."""
    is_problem(shared.client.get("/v1/avatars", headers={"Host": host}), 400, "bad-host")


@pytest.mark.parametrize("host", ["localhost", "localhost:8000", "127.0.0.1:1", "[::1]:8000", "10.1.2.3"])
def test_addresses_and_own_names_are_let_in(shared: Api, host: str) -> None:
    assert shared.client.get("/livez", headers={"Host": host}).status_code == 200


def test_a_list_of_names_shuts_out_all_others_but_for_probes(tmp_path: Path) -> None:
    """Prometheus and Kubernetes know a pod by its address; a page with a name of its own never sends one."""
    settings = Settings(data=tmp_path / "data", program=TOY, reserve_mb=1, allowed_hosts="avatars.example")
    with open_api(settings) as client:
        for path, host, status in (
            ("/livez", "avatars.example", 200), ("/livez", "10.1.2.3:8000", 200), ("/metrics", "[fd00::1]", 200),
            ("/livez", "evil.example", 400), ("/livez", "localhost", 400), ("/v1/models", "10.1.2.3", 400),
        ):  # fmt: skip
            assert client.get(path, headers={"Host": host}).status_code == status, (path, host)


@pytest.mark.parametrize("value", ["", "x" * 256, "ä", "a\tb"])
def test_a_key_for_repeating_has_to_be_printable(shared: Api, value: str) -> None:
    answer = shared.client.post(
        "/v1/avatars", files={"image": ("x", GOOD)}, headers={b"Idempotency-Key": value.encode("latin-1")}
    )
    is_problem(answer, 400, "invalid-parameter")


@pytest.mark.parametrize(
    "query", ["limit=0", "limit=101", "limit=x", "cursor=x", "cursor=W10", "cursor=bnVsbA", "state=x"]
)
def test_parameters_of_the_list_are_checked(shared: Api, query: str) -> None:
    is_problem(shared.client.get(f"/v1/avatars?{query}"), 422, "invalid-parameter")


def test_an_unexpected_mistake_tells_nothing(shared: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*a: Any) -> None:
        raise RuntimeError("secret of the inside")

    monkeypatch.setattr(shared.context.store, "page", fail)
    answer = shared.client.get("/v1/avatars")
    is_problem(answer, 500, "internal")
    assert "secret" not in answer.text
    assert answer.headers["connection"] == "close", "the line is closed, and a client has to know"


def test_every_code_has_its_page(shared: Api) -> None:
    from service.api.problem_responses import EXPLANATIONS
    from service.jobs.view import TITLES

    for code in {*EXPLANATIONS, *TITLES}:
        assert shared.client.get(f"/problems/{code}").status_code == 200
    is_problem(shared.client.get("/problems/nothing"), 404, "not-found")


def test_the_service_has_nothing_to_fetch_with() -> None:
    """No URL is ever fetched: what handles requests and jobs imports no HTTP client, and ours none at all."""
    import ast
    import subprocess
    import sys
    from pathlib import Path

    modules = "sys, service.api.server, service.jobs.worker, service.jobs.avatar_process"
    program = f"import {modules}; print(*sys.modules)"
    child = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert not {"httpx", "requests", "urllib3", "aiohttp"} & set(child.stdout.split())
    root = Path(__file__).parents[3] / "service"
    for file in {*(root / "api").glob("*.py"), *(root / "jobs").glob("*.py")} - {root / "jobs" / "webhooks.py"}:
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not {"urllib.request", "http.client", "ftplib", "pickle"} & set(names), file


def test_a_webhook_that_leads_inside_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was taken, and tried again and again in vain. A request that was taken before is still the same job."""
    (tmp_path / "secret").write_bytes(bytes(32))
    hosts = "localhost, hooks.invalid"
    settings = Settings(data=tmp_path / "data", reserve_mb=1, webhook_hosts=hosts, webhook_secret=f"{tmp_path}/secret")
    with open_api(settings) as client:

        def post(host: str, key: str) -> httpx2.Response:
            parts = {"webhook_url": f"https://{host}/x"}
            headers = {"Idempotency-Key": key}
            return client.post("/v1/avatars", files={"image": ("a.jpg", GOOD)}, data=parts, headers=headers)

        refused = post("localhost", "first")
        is_problem(refused, 422, "usage")
        assert refused.json()["pointer"] == "/webhook_url"
        assert "webhook_url leads to localhost, " in refused.json()["detail"]
        assert "WEBHOOK_PRIVATE" in refused.json()["detail"]
        taken = post("hooks.invalid", "second")
        assert taken.status_code == 202, "a name without an address now may have one when the job ends"
        monkeypatch.setattr("socket.getaddrinfo", lambda *_, **__: [(0, 0, 0, "", ("10.0.0.8", 443))])
        assert post("hooks.invalid", "second").json()["id"] == taken.json()["id"]
        is_problem(post("hooks.invalid", "third"), 422, "usage")


def test_a_photo_in_pieces_of_any_size_is_the_same_photo(shared: Api) -> None:
    """The streaming parser sees boundaries in every position."""
    whole = part("image", GOOD) + part("options", b'{"seed": 3}') + END
    found = set()
    for size in (7, 61, 1000, len(whole)):
        pieces = (whole[start : start + size] for start in range(0, len(whole), size))
        answer = shared.client.post(
            "/v1/avatars", content=pieces, headers={"Content-Type": "multipart/form-data; boundary=b"}
        )
        assert answer.status_code == 202, answer.text
        row = shared.context.store.get(answer.json()["id"])
        assert row is not None
        found.add((row["photo_sha256"], row["photo_bytes"], row["digest"]))
    assert len(found) == 1
    assert io.BytesIO(GOOD).getbuffer().nbytes in {entry[1] for entry in found}


def test_a_foreign_page_gets_no_permission(shared: Api) -> None:
    answer = shared.client.get("/v1/avatars", headers={"Origin": "https://evil.example"})
    assert not [name for name in answer.headers if name.startswith("access-control")]
    assert answer.headers["cross-origin-resource-policy"] == "same-origin"
