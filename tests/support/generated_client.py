"""Does a client that a program wrote from the OpenAPI document work? Generate one and make an avatar with it.

    python -m tests.support.generated_client

Installs openapi-python-client into an environment of its own in a temporary folder (``--generator PATH`` names one that
is installed already), starts a server with the pipeline, posts the sample photo for its texture alone, waits, lists and
downloads with the generated functions only, and compares what came with what the server has. Whatever the generator
warns of is printed, and makes the exit status 1.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import io
import json
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import httpx

from service.diagnosis import SAMPLE
from tests.support.server import Server

PACKAGE = "avatarme_client"

BYTES = ("application/zip", "image/png", "image/jpeg", "image/webp")
"""Media types that this generator has to be told are bytes."""


def generate(generator: Path, document: bytes, folder: Path) -> str:
    """Write the package ``PACKAGE`` below ``folder``; returns what the generator says.

    Args:
        generator: the program ``openapi-python-client``.
        document: the OpenAPI document, JSON.
        folder: for the document, the generator's settings and the package.

    Raises:
        subprocess.CalledProcessError: it gave up.
    """
    (folder / "openapi.json").write_bytes(document)
    settings = {"content_type_overrides": dict.fromkeys(BYTES, "application/octet-stream"), "post_hooks": []}
    (folder / "generator.json").write_text(json.dumps(settings), "utf-8")
    arguments = ("generate", "--path", "openapi.json", "--config", "generator.json", "--output-path", "made")
    told = subprocess.run([str(generator), *arguments], cwd=folder, check=True, capture_output=True, text=True)
    return told.stdout + told.stderr


def load(folder: Path) -> None:
    """Make the generated package importable under its name."""
    place = folder / "made" / PACKAGE
    spec = importlib.util.spec_from_file_location(
        PACKAGE, place / "__init__.py", submodule_search_locations=[str(place)]
    )
    if spec is None or spec.loader is None:
        raise ImportError(f"{place} holds no package")
    module = importlib.util.module_from_spec(spec)
    sys.modules[PACKAGE] = module
    spec.loader.exec_module(module)


def use(url: str, photo: bytes) -> dict[str, Any]:
    """Make an avatar with the generated functions; returns what was found.

    Raises:
        RuntimeError: an answer is not what the description promises.
    """
    client = _part("client").Client(base_url=url, raise_on_unexpected_status=True, timeout=60.0)
    models = _part("models")
    body = models.NewAvatar(
        image=_part("types").File(payload=io.BytesIO(photo), file_name="photo.png", mime_type="image/png"),
        options=models.Options(maps=[models.OptionsMapsItem.TEXTURE], quality=models.OptionsQuality.DRAFT),
        keep_photo=True,
    )
    job = _part("api.avatars.create_avatar").sync(client=client, body=body, idempotency_key="once")
    again = _part("api.avatars.get_avatar")
    begin = time.monotonic()
    while job.state in (models.JobState.QUEUED, models.JobState.RUNNING):
        if time.monotonic() - begin > 600:
            raise RuntimeError(f"the job is {job.state} after ten minutes")
        time.sleep(0.5)
        job = again.sync(client=client, job=job.id)
    if job.state != models.JobState.SUCCEEDED:
        raise RuntimeError(f"the job ended as {job.to_dict()}")
    files = _part("api.results.list_files").sync(client=client, job=job.id).items
    download = _part("api.results.download_archive")
    whole = download.sync(client=client, job=job.id).payload.read()
    rest = download.sync(client=client, job=job.id, range_="bytes=1000-").payload.read()
    texture = _part("api.results.download_file").sync(client=client, job=job.id, path="maps/texture.png").payload.read()
    missing = again.sync(client=client, job="0" * 32)
    listed = _part("api.avatars.list_avatars").sync(client=client, limit=10).items
    if rest != whole[1000:] or texture not in whole or job.id not in [item.id for item in listed]:
        raise RuntimeError("a range, a file or the list is not what it has to be")
    if missing.code != "not-found":
        raise RuntimeError(f"a job that is not there is answered with {missing}")
    return {"job": job.id, "files": len(files), "archive": whole, "seconds": time.monotonic() - begin}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--generator", type=Path, help="openapi-python-client, where it is installed already")
    asked = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="generated-") as place:
        folder = Path(place)
        generator = asked.generator or _installed(folder / "environment")
        server = Server(folder / "data", {"program": "service.jobs.avatar_process"})
        server.start()
        try:
            words = generate(generator.absolute(), httpx.get(f"{server.url}/openapi.json").content, folder)
            print(words.strip())
            load(folder)
            found = use(server.url, SAMPLE.read_bytes())
            same = httpx.get(f"{server.url}/v1/avatars/{found['job']}/archive.zip").content == found["archive"]
        finally:
            server.stop()
    print(f"{found['files']} files, {len(found['archive'])} bytes after {found['seconds']:.1f} s; same bytes: {same}")
    raise SystemExit(0 if same and "arning" not in words else 1)


def _installed(place: Path) -> Path:
    venv.create(place, with_pip=True)
    subprocess.run([place / "bin" / "python", "-m", "pip", "install", "-qq", "openapi-python-client"], check=True)
    return place / "bin" / "openapi-python-client"


def _part(name: str) -> Any:
    return importlib.import_module(f"{PACKAGE}.{name}")


if __name__ == "__main__":
    main()
