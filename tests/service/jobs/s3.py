"""S3 servers on the loopback, for tests: what one holds stays when it is stopped and started."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import pytest

from tests.support.server import free_port
from tests.support.swift import Swift, missing

REASON = "moto[s3], flask, flask-cors or s3fs is not installed: pip install -e '.[dev]'"

SERVERS = ("moto", "swift")
"""A mock that checks no signature, and a server that is used in earnest."""


class S3(Protocol):
    """One server."""

    environment: dict[str, str]

    def start(self) -> None:
        """Start, and wait until it answers."""

    def stop(self) -> None:
        """End it at once."""


class Moto:
    """Moto's server."""

    def __init__(self) -> None:
        from moto.server import ThreadedMotoServer

        logging.getLogger("werkzeug").setLevel(logging.ERROR)
        self._port = free_port()
        self._make: Any = ThreadedMotoServer
        self.environment = {
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{self._port}", "AWS_ACCESS_KEY_ID": "x",
            "AWS_SECRET_ACCESS_KEY": "x", "AWS_DEFAULT_REGION": "us-east-1",
        }  # fmt: skip

    def stop(self) -> None:
        self._server.stop()

    def start(self) -> None:
        self._server = self._make(ip_address="127.0.0.1", port=self._port, verbose=False)
        self._server.start()


def serve(name: str, folder: Path) -> Iterator[S3]:
    """For a fixture: a server with one bucket; the variables that lead to it are set meanwhile.

    Args:
        name: of ``SERVERS``.
        folder: for its files.
    """
    pytest.importorskip("moto.server", reason=REASON)
    s3fs = pytest.importorskip("s3fs", reason=REASON)
    if name == "swift" and missing():
        pytest.skip("Swift is not installed: apt-get install swift-proxy swift-account swift-container swift-object")
    server: S3 = Swift(folder) if name == "swift" else Moto()
    server.start()
    with pytest.MonkeyPatch.context() as patch:
        for variable, value in server.environment.items():
            patch.setenv(variable, value)
        s3fs.S3FileSystem.clear_instance_cache()
        s3fs.S3FileSystem().mkdir("bucket")
        yield server
        s3fs.S3FileSystem.clear_instance_cache()
    server.stop()
