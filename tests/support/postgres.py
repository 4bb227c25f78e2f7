"""A Postgres of our own in a folder, for trying the service with several workers. Needs Debian's package postgresql."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
from pathlib import Path

from tests.support.server import free_port

USER = "avatarme"


def find_programs() -> Path | None:
    """Folder of initdb and pg_ctl, None where there is no Postgres."""
    found = shutil.which("initdb")
    candidates = [Path(found).parent] if found else sorted(Path("/usr/lib/postgresql").glob("*/bin"))[::-1]
    return next((folder for folder in candidates if (folder / "initdb").exists()), None)


class Postgres:
    """One server that listens on the loopback only.

    Args:
        folder: for its files.
        connections: that it takes at the same time.

    Raises:
        RuntimeError: there is no Postgres on this machine.
    """

    def __init__(self, folder: Path, connections: int = 200) -> None:
        self._connections = connections
        programs = find_programs()
        if programs is None:
            raise RuntimeError("Postgres is not installed; apt-get install postgresql")
        self._programs = programs
        self._data = folder / "postgres"
        self._data.mkdir(parents=True)
        # It refuses to run as root; the Debian package comes with a user for it.
        self._user = "postgres" if os.geteuid() == 0 else None
        if self._user is not None:
            shutil.chown(self._data, self._user)
            for parent in [self._data, *self._data.parents][1:]:
                with contextlib.suppress(OSError):
                    parent.chmod(parent.stat().st_mode | 0o011)
        self.port = free_port()
        self.url = self.url_by(self.port)
        self._run("initdb", "-D", str(self._data), "-U", USER, "-A", "trust", "--no-sync")

    @staticmethod
    def url_by(port: int) -> str:
        """How it is reached by a port: its own, or that of a :class:`tests.support.slow_line.Line` that leads to it."""
        return f"postgresql://{USER}@127.0.0.1:{port}/postgres"

    def start(self) -> None:
        """Start, and wait until it answers."""
        options = f"-p {self.port} -c listen_addresses=127.0.0.1 -c unix_socket_directories=''"
        options += f" -c max_connections={self._connections}"
        self._run("pg_ctl", "-D", str(self._data), "-o", options, "-l", str(self._data / "log"), "-w", "start")

    def process(self) -> int:
        """Id of its first process, which the others descend from."""
        return int((self._data / "postmaster.pid").read_text().split()[0])

    def stop(self, mode: str = "fast") -> None:
        """Stop: "fast" says good-bye to clients, "immediate" is like pulling the plug."""
        self._run("pg_ctl", "-D", str(self._data), "-m", mode, "-w", "stop")

    def _run(self, program: str, *arguments: str) -> None:
        subprocess.run(
            [str(self._programs / program), *arguments], check=True, user=self._user, cwd="/", stdout=subprocess.DEVNULL
        )
