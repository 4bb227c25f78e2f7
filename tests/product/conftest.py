from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
from PIL import Image

from service.client.client import canonical, idempotency_key, photo_sha256
from service.diagnosis import SAMPLE
from tests.end_to_end.command import ROOT, avatarme
from tests.support.server import Server, wait_for

PEOPLE = ROOT / "tests" / "data" / "people"
SMALL = {"quality": "draft", "size": [384, 256]}
"""Draft, and maps so small that one photo takes seconds."""
FLAGS = ("--quality", "draft", "--size", "384x256")

Archives = dict[str, bytes]


def heic(path: Path) -> bytes:
    """A picture as a phone writes it."""
    import pillow_heif

    stream = io.BytesIO()
    pillow_heif.from_pillow(Image.open(path).convert("RGB")).save(stream, quality=90)
    return stream.getvalue()


def manifest_of(archive: bytes) -> dict[str, Any]:
    with zipfile.ZipFile(io.BytesIO(archive)) as opened:
        manifest: dict[str, Any] = json.loads(opened.read("manifest.json"))
    return manifest


@pytest.fixture(scope="session")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sample and four people who wear what breaks things; the smiling one comes from a phone."""
    folder = tmp_path_factory.mktemp("photos")
    (folder / "sample.png").write_bytes(SAMPLE.read_bytes())
    for name in ("closed", "full_beard", "mouth_open"):
        (folder / f"{name}.jpg").write_bytes((PEOPLE / f"{name}.jpg").read_bytes())
    (folder / "wide_smile.heic").write_bytes(heic(PEOPLE / "wide_smile.jpg"))
    return folder


def archives_in(folder: Path) -> Archives:
    return {path.name.partition(".")[0]: path.read_bytes() for path in folder.glob("*.zip")}


@pytest.fixture(scope="session")
def local(photos: Path, tmp_path_factory: pytest.TempPathFactory) -> Archives:
    """What ``avatarme batch`` makes of the photos in processes of this machine."""
    out = tmp_path_factory.mktemp("local")
    run = avatarme("batch", photos, out, "--jobs", "2", *FLAGS)
    assert run.status == 0, run.stderr
    return archives_in(out)


@dataclass(frozen=True)
class Service:
    """A running ``avatarme serve`` with the pipeline itself, two photos at a time, and a client of it."""

    server: Server
    client: httpx.Client

    def post(self, photo: bytes, name: str = "photo") -> str:
        """Hand a photo in; returns the job, which is that of ``avatarme batch --server`` for a file of this name."""
        files: Any = {"image": ("photo", photo), "options": (None, json.dumps(SMALL), "application/json")}
        key = idempotency_key(photo_sha256(photo), canonical(SMALL), name, 1, 0)
        answer = self.client.post("/v1/avatars", files=files, headers={"Idempotency-Key": key})
        assert answer.status_code == 202, answer.text
        job: str = answer.json()["id"]
        return job

    def archive(self, job: str) -> bytes:
        """Wait for the job and fetch what it made."""
        state = wait_for(self.client, job, within=240)
        assert state["state"] == "succeeded", state
        return self.client.get(f"/v1/avatars/{job}/archive.zip").content


@contextmanager
def running(data: Path) -> Iterator[Service]:
    """A service on a folder until the end of the block."""
    server = Server(data, {"jobs": 2, "program": "service.jobs.avatar_process"})
    server.start()
    with httpx.Client(base_url=server.url, timeout=120) as client:
        yield Service(server, client)
    assert server.stop() == 0


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    with running(tmp_path_factory.mktemp("served") / "data") as made:
        yield made


@pytest.fixture(scope="session")
def jobs(service: Service, photos: Path) -> dict[str, str]:
    """The photos handed in at once; job by photo."""
    return {path.stem: service.post(path.read_bytes(), path.name) for path in sorted(photos.iterdir())}


@pytest.fixture(scope="session")
def served(service: Service, jobs: dict[str, str]) -> Archives:
    """What the server made of them."""
    return {name: service.archive(job) for name, job in jobs.items()}
