"""A server or worker that dies by SIGKILL at a chosen point, or claims to be of another version; a program for tests.

    python -m tests.service.jobs.dying worker POINT
    python -m tests.service.jobs.dying server POINT

POINT is ``module:Class.name:before`` (or ``after``): the process ends as soon as that function is called, or has
returned. ``version:NAME`` changes the version of the steps instead. A worker reads its settings from standard input, a
server from the environment, as the real ones do.
"""

from __future__ import annotations

import functools
import importlib
import os
import signal
import sys
from typing import Any


def die_at(point: str) -> None:
    """Put the end of this process into a function."""
    module, path, when = point.split(":")
    owner: Any = importlib.import_module(module)
    *parents, name = path.split(".")
    for parent in parents:
        owner = getattr(owner, parent)
    whole = getattr(owner, name)

    @functools.wraps(whole)
    def dying(*arguments: Any, **named: Any) -> Any:
        if when == "after":
            whole(*arguments, **named)
        os.kill(os.getpid(), signal.SIGKILL)

    setattr(owner, name, dying)


def main() -> int:
    """Become the one or the other."""
    _, role, point = sys.argv
    del sys.argv[1:]
    if point.startswith("version:"):
        from service.jobs import settings

        settings.PIPELINE_VERSION = point.partition(":")[2]
    elif point:
        die_at(point)
    if role == "worker":
        from service.jobs.worker_process import main as work

        return work()
    from service.api.server import serve
    from service.jobs.settings import from_environment

    serve(from_environment({}), with_worker=False)
    return 0


if __name__ == "__main__":
    sys.exit(main())
