"""A process for one photo that does what the photo's first word says; takes the place of the pipeline in tests."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

from service.errors import CorruptImage, OutputFault
from service.jobs.process import Reporter, Task
from tests.support.archives import archive


def toy_archive(photo: bytes, options: dict[str, Any]) -> bytes:
    """What an undisturbed run makes."""
    return archive({"photo": photo, "options": json.dumps(options).encode()})


def run(task: Task, reporter: Reporter) -> None:
    word = Path(task.photo).read_bytes().split()[0].decode()
    reporter.progress("fit", 0.5)
    if word == "corrupt":
        raise CorruptImage("the file is cut off", bytes=12)
    if word == "crash":
        os.write(2, b"last words of a library\n")
        os.kill(os.getpid(), signal.SIGSEGV)
    if word == "leave":
        os._exit(7)
    if word == "bug":
        raise ZeroDivisionError("depth was 0")
    if word == "full":
        raise OutputFault("cannot write the archive: no space left on device")
    if word == "hang":
        Path(task.photo).with_suffix(".started").write_text(str(os.getpid()))
        time.sleep(60)
    data = toy_archive(Path(task.photo).read_bytes(), dict(task.options))
    Path(task.output).write_bytes(data[:-50] if word == "short" else data)
    sys.stdout.write("noise of a library\n")
    sys.stdout.flush()
    reporter.done({"sha256": hashlib.sha256(data).hexdigest(), "warnings": ["no-colour"] if word == "grey" else []})
