"""Workers as processes of their own, which share a database and a folder of artifacts: started, frozen, killed."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from service.jobs.process import descendants
from service.jobs.settings import PREFIX
from tests.support.toy_job import LOG, SECONDS


class Workers:
    """Processes of ``avatarme worker`` that share a database and a folder of artifacts.

    Args:
        folder: for their data and logs.
        settings: of all of them.
        names: one for each.
        own: settings of single workers by name.
        log: that the toy job writes, if any.
        seconds: that each stage takes.
    """

    def __init__(
        self,
        folder: Path,
        settings: dict[str, object],
        names: Sequence[str],
        own: Mapping[str, Mapping[str, object]] | None = None,
        log: Path | None = None,
        seconds: float = 1.0,
    ) -> None:
        self._folder = folder
        self._settings = settings
        self._own = own or {}
        self._environment = {SECONDS: str(seconds)} | ({} if log is None else {LOG: str(log)})
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        for name in names:
            self.start(name)

    def start(self, name: str) -> None:
        """Start the worker of a name."""
        values = {**self._settings, **self._own.get(name, {}), "data": self._folder / name, "worker": name}
        environment = os.environ | {PREFIX + key.upper(): str(value) for key, value in values.items()}
        environment |= self._environment
        with (self._folder / f"{name}.log").open("ab") as log:
            self.running[name] = subprocess.Popen(
                [sys.executable, "-m", "service", "worker"], env=environment, stdout=log, stderr=log
            )

    def restart(self) -> None:
        """Start those again that do not run."""
        for name, process in self.running.items():
            if process.poll() is not None:
                self.start(name)

    def owner(self, line: str) -> str | None:
        """The worker whose job wrote a line of the log, None where it has ended or is the frozen one's."""
        job = int(line.split()[-1])
        for name, process in self.running.items():
            if job in descendants(process.pid):
                return name
        return None

    def signal(self, name: str, number: signal.Signals, *, jobs: bool = True) -> None:
        """Send a signal to a worker, and to the processes of its jobs unless ``jobs`` is False."""
        process = self.running[name].pid
        for other in [process, *descendants(process)]:
            with contextlib.suppress(OSError):
                if jobs or b"toy_job" not in Path(f"/proc/{other}/cmdline").read_bytes():
                    os.kill(other, number)

    def stop(self) -> None:
        """Kill all."""
        for name, process in self.running.items():
            self.signal(name, signal.SIGCONT)
            self.signal(name, signal.SIGKILL)
            process.wait()
