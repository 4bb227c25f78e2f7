"""The image as it is shipped: ``make image-test [PHOTO=me.jpg]``.

Builds the Dockerfile with neither a Docker daemon nor a registry (buildah; the base image is made of this machine's
Debian packages and Python where it is missing), runs it as its own user with a volume, and then

- hands a photo in by HTTP, and a folder by ``avatarme batch``;
- stops it by SIGTERM while a job runs, which has to drain, and starts it again on the same volume: the job ends, what
  was finished is still there to the byte, the key is the same;
- looks whether it has a torch or a pip.

By chroot, so it shows neither limits of cgroups nor seccomp nor a container's network. Wants root, ``buildah`` and
``mmdebstrap``.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

from service.diagnosis import SAMPLE
from service.jobs.process import descendants
from tests.support.server import free_port, wait_for

ROOT = Path(__file__).resolve().parents[2]
BUILDAH = ("buildah", "--storage-driver", "vfs")
IMAGE = "localhost/avatarme:test"
USER = 10001
DRAFT = {"quality": "draft", "size": [384, 256]}
SHARED = ("/etc/ssl/certs", "/etc/resolv.conf", "/etc/pip.conf")
"""What a build without a daemon takes from this machine, where it is there: certificates and settings of pip."""


def package_folders() -> list[str]:
    """Folders of this machine that pip's settings name as sources of packages."""
    command = [sys.executable, "-m", "pip", "config", "list"]
    settings = subprocess.run(command, capture_output=True, text=True, check=True)
    found = re.findall(r"(?<![\w:/])(?:file://)?(/[^\s'\"]+)", settings.stdout)
    return sorted({str(Path(path).parent if path.endswith("/simple") else Path(path)) for path in found})


def say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def buildah(*arguments: str) -> str:
    """Run buildah; returns what it prints."""
    done = subprocess.run([*BUILDAH, *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"buildah {arguments[0]}: {(done.stdout + done.stderr)[-2000:]}")
    return done.stdout.strip()


def build() -> None:
    """The image of the Dockerfile, and before that its base where it is missing."""
    text = (ROOT / "Dockerfile").read_text("utf-8")
    found = re.search(r"^ARG PYTHON_VERSION=(\S+)", text, re.MULTILINE)
    assert found is not None
    base = f"docker.io/library/python:{found[1]}-slim-bookworm"
    if subprocess.run([*BUILDAH, "inspect", "--type", "image", base], capture_output=True, check=False).returncode:
        subprocess.run(["bash", str(Path(__file__).with_name("image_base.sh")), base], check=True)
    wanted = [*filter(os.path.exists, SHARED), *filter(os.path.isdir, package_folders())]
    mounts = [flag for path in wanted for flag in ("-v", f"{path}:{path}:ro")]
    begin = time.monotonic()
    how = ("--layers", "--pull-never", "--isolation", "chroot", "--network", "host")
    buildah("bud", *how, *mounts, "-t", IMAGE, str(ROOT))
    say(f"built in {time.monotonic() - begin:.0f} s: {buildah('images', '--format', '{{.Size}}', IMAGE)}")


class Container:
    """The image at work on a volume.

    Args:
        volume: folder of this machine for the data.
    """

    def __init__(self, volume: Path) -> None:
        self.volume = volume
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self.name = buildah("from", "--pull-never", IMAGE)
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start, and wait until it is ready."""
        # Not at /data: there buildah puts a volume of its own over it, as the image asks for one.
        flags = ("--isolation", "chroot", "--network", "host", "--user", f"{USER}:{USER}", "-v", f"{self.volume}:/kept")
        chosen = {"PORT": self.port, "DATA": "/kept", "KEYS": "/kept/keys.json"}
        variables = [flag for name, value in chosen.items() for flag in ("--env", f"AVATARME_{name}={value}")]
        command = (self.name, "--", "tini", "--", "avatarme", "serve")
        with self.volume.with_name("log").open("ab") as log:
            self.process = subprocess.Popen(
                [*BUILDAH, "run", *flags, *variables, *command],
                stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline:
            try:
                if httpx.get(f"{self.url}/readyz", timeout=2).status_code == 200:
                    return
            except httpx.HTTPError:
                pass
            time.sleep(0.2)
        raise SystemExit(f"it does not become ready: {self.volume.with_name('log').read_text()[-2000:]}")

    def server(self) -> int:
        """Process id of the server itself, of the child of tini."""
        assert self.process is not None
        for process in descendants(self.process.pid):
            words = Path(f"/proc/{process}/cmdline").read_bytes().split(b"\0")
            if b"serve" in words and b"python" in words[0]:
                return process
        raise SystemExit("there is no server in the container")

    def stop(self) -> float:
        """SIGTERM, as ``docker stop`` sends it; returns the seconds until it is over."""
        assert self.process is not None
        begin = time.monotonic()
        os.kill(self.server(), signal.SIGTERM)
        self.process.wait(60)
        return time.monotonic() - begin

    def remove(self) -> None:
        """End what still runs, and the container."""
        if self.process is not None and self.process.poll() is None:
            for process in [self.process.pid, *descendants(self.process.pid)]:
                try:
                    os.kill(process, signal.SIGKILL)
                except OSError:
                    continue
            self.process.wait()
        buildah("rm", self.name)


@contextmanager
def container() -> Iterator[Container]:
    """A container with an empty volume."""
    with tempfile.TemporaryDirectory() as folder:
        volume = Path(folder) / "data"
        volume.mkdir()
        os.chown(volume, USER, USER)
        os.chmod(folder, 0o755)  # noqa: S103 - the user of the image has to reach its volume
        made = Container(volume)
        try:
            yield made
        finally:
            made.remove()


def look(made: Container, photo: Path) -> None:
    """Everything of this module's docstring."""
    made.start()
    status = Path(f"/proc/{made.server()}/status").read_text()
    uids = re.search(r"^Uid:\s+(\d+)", status, re.MULTILINE)
    assert uids is not None and int(uids[1]) == USER, status
    key = (made.volume / "first-key.txt").read_text().strip()
    inside = Path(f"/proc/{made.server()}/root")
    names = {path.name for path in (inside / "app").glob("lib/python3*/site-packages/*")}
    assert not {"torch", "pip", "pytest"} & names, names
    say(f"runs as user {USER}, without torch and pip")
    with httpx.Client(base_url=made.url, timeout=60, headers={"Authorization": f"Bearer {key}"}) as client:
        assert httpx.get(f"{made.url}/v1/avatars").status_code == 401
        first = post(client, photo)
        state = wait_for(client, first, within=300)
        assert state["state"] == "succeeded", state
        archive = client.get(f"/v1/avatars/{first}/archive.zip").content
        say(f"a photo by HTTP: {state['state']}, {len(archive)} bytes")
        second = post(client, photo, seed=1)
        while client.get(f"/v1/avatars/{second}").json()["state"] == "queued":
            time.sleep(0.05)
    say(f"stopped in {made.stop():.1f} s while a job ran")
    made.start()
    assert (made.volume / "first-key.txt").read_text().strip() == key
    with httpx.Client(base_url=made.url, timeout=60, headers={"Authorization": f"Bearer {key}"}) as client:
        assert client.get(f"/v1/avatars/{first}/archive.zip").content == archive
        state = wait_for(client, second, within=300)
        assert state["state"] == "succeeded", state
    say("started again on its volume: the finished archive is the same, the job that ran has ended")
    batch(made, photo, key)


def post(client: httpx.Client, photo: Path, **options: Any) -> str:
    """Hand a photo in; returns the job."""
    chosen = json.dumps({**DRAFT, **options})
    files: Any = {"image": (photo.name, photo.read_bytes()), "options": (None, chosen, "application/json")}
    answer = client.post("/v1/avatars", files=files)
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


def batch(made: Container, photo: Path, key: str) -> None:
    """The client of this machine against the container."""
    with tempfile.TemporaryDirectory() as folder:
        photos, out = Path(folder) / "photos", Path(folder) / "out"
        photos.mkdir()
        shutil.copy(photo, photos / photo.name)
        command = [sys.executable, "-m", "service", "batch", str(photos), str(out), "--server", made.url]
        environment = {**os.environ, "AVATARME_API_KEY": key}
        flags = ("--quality", "draft", "--size", "384x256")
        subprocess.run([*command, *flags], cwd=ROOT, env=environment, check=True, capture_output=True)
        assert [path.name for path in out.glob("*.zip")], "batch wrote no archive"
    say("a folder by avatarme batch: done")
    say(f"stopped in {made.stop():.1f} s while nothing ran")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photo", type=Path, nargs="?", default=SAMPLE)
    asked = parser.parse_args()
    missing = [name for name in ("buildah", "mmdebstrap") if shutil.which(name) is None]
    if missing or os.geteuid() != 0:
        raise SystemExit(f"wants root, buildah and mmdebstrap; missing are {', '.join(missing) or 'none of these'}")
    build()
    with container() as made:
        look(made, asked.photo)
    say("the image does what it has to")


if __name__ == "__main__":
    main()
