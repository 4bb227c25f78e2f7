"""S3 servers on the loopback, for tests: what one holds stays when it is stopped and started."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import Any

import pytest

from service.places import S3 as S3_CLIENT
from tests.support.server import free_port

REASON = "moto[s3], flask, flask-cors or s3fs is not installed: pip install -e '.[dev]'"


class S3:
    """Moto's server; it checks no signature."""

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


def serve() -> Iterator[S3]:
    """For a fixture: a server with one bucket; the variables that lead to it are set meanwhile."""
    pytest.importorskip("moto.server", reason=REASON)
    s3fs = pytest.importorskip("s3fs", reason=REASON)
    server = S3()
    server.start()
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(S3_CLIENT["config_kwargs"], "retries", {"max_attempts": 0})  # a server that is stopped stays away
        for variable, value in server.environment.items():
            patch.setenv(variable, value)
        s3fs.S3FileSystem.clear_instance_cache()
        s3fs.S3FileSystem().makedirs("bucket", exist_ok=True)  # all servers of a process share their buckets
        yield server
        s3fs.S3FileSystem.clear_instance_cache()
    server.stop()
