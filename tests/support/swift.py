"""An OpenStack Swift of our own in a folder: an S3 server that is used in earnest, for trying the service with a store.

Needs Debian's packages swift-proxy, swift-account, swift-container and swift-object, and a file system with extended
attributes.
"""

from __future__ import annotations

import contextlib
import os
import pwd
import shutil
import socket
import subprocess
import time
from pathlib import Path

from tests.support.server import free_port

USER, SECRET = "test:tester", "testing"
REGION = "us-east-1"

_KINDS = ("object", "container", "account")

_COMMON = """[DEFAULT]
bind_ip = 127.0.0.1
bind_port = {port}
workers = 0
user = {user}
swift_dir = {folder}
devices = {folder}/disks
mount_check = false
log_level = ERROR
"""

_PROXY = """
[pipeline:main]
pipeline = catch_errors proxy-logging cache s3api tempauth copy slo proxy-logging proxy-server
[app:proxy-server]
use = egg:swift#proxy
account_autocreate = true
[filter:catch_errors]
use = egg:swift#catch_errors
[filter:proxy-logging]
use = egg:swift#proxy_logging
[filter:cache]
use = egg:swift#memcache
memcache_servers = 127.0.0.1:1
[filter:s3api]
use = egg:swift#s3api
location = {region}
[filter:tempauth]
use = egg:swift#tempauth
user_{user_} = {secret} .admin
[filter:copy]
use = egg:swift#copy
[filter:slo]
use = egg:swift#slo
"""


def missing() -> list[str]:
    """Programs of Swift that are not on this machine."""
    programs = ["swift-ring-builder", "swift-proxy-server", *(f"swift-{kind}-server" for kind in _KINDS)]
    return [program for program in programs if shutil.which(program) is None]


class Swift:
    """One cluster with one disk, on the loopback; what it holds stays when it is stopped and started.

    Args:
        folder: for its files.

    Raises:
        RuntimeError: Swift is not installed, or does not start.
    """

    def __init__(self, folder: Path) -> None:
        if missing():
            raise RuntimeError(f"Swift is not installed: there is no {', '.join(missing())}")
        self._folder = folder
        (folder / "disks" / "disk").mkdir(parents=True)
        self._ports = {kind: free_port() for kind in _KINDS}
        self.port = free_port()
        self._processes: list[subprocess.Popen[bytes]] = []
        (folder / "swift.conf").write_text("[swift-hash]\nswift_hash_path_suffix = a\nswift_hash_path_prefix = b\n")
        for kind in _KINDS:
            ring = str(folder / f"{kind}.builder")
            device = f"r1z1-127.0.0.1:{self._ports[kind]}/disk"
            for words in (("create", "4", "1", "0"), ("add", device, "1"), ("rebalance",)):
                subprocess.run(["swift-ring-builder", ring, *words], check=True, stdout=subprocess.DEVNULL)
            self._configure(kind, self._ports[kind], f"[pipeline:main]\npipeline = {kind}-server\n"
                            f"[app:{kind}-server]\nuse = egg:swift#{kind}\n")  # fmt: skip
        account, name = USER.split(":")
        self._configure("proxy", self.port, _PROXY.format(region=REGION, user_=f"{account}_{name}", secret=SECRET))
        self.environment = {
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{self.port}", "AWS_ACCESS_KEY_ID": USER,
            "AWS_SECRET_ACCESS_KEY": SECRET, "AWS_DEFAULT_REGION": REGION,
        }  # fmt: skip

    def start(self, within: float = 120.0) -> None:
        """Start, and wait until all its servers listen.

        Raises:
            RuntimeError: they do not within the time.
        """
        environment = {"PATH": os.environ.get("PATH", ""), "SWIFT_TEST_IN_PROCESS": ""}
        with (self._folder / "log").open("ab") as log:
            for kind in (*_KINDS, "proxy"):
                command = [f"swift-{kind}-server", str(self._folder / f"{kind}.conf")]
                self._processes.append(subprocess.Popen(command, env=environment, stdout=log, stderr=log))
        deadline = time.monotonic() + within
        for port in (*self._ports.values(), self.port):
            while not _listens(port):
                if time.monotonic() > deadline or any(process.poll() is not None for process in self._processes):
                    self.stop()
                    raise RuntimeError(f"Swift does not start; see {self._folder / 'log'}")
                time.sleep(0.1)

    def stop(self) -> None:
        """End all its servers at once."""
        for process in self._processes:
            process.kill()
            process.wait()
        self._processes.clear()

    def _configure(self, kind: str, port: int, rest: str) -> None:
        user = pwd.getpwuid(os.geteuid()).pw_name
        text = _COMMON.format(port=port, folder=self._folder, user=user) + rest
        (self._folder / f"{kind}.conf").write_text(text)


def _listens(port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
        return True
    return False
