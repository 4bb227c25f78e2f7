"""A picture that takes no time, in place of the renderer (``Settings.archive_program``), and faults on request.

``view`` of the request chooses a fault: "back" is a mistake in the program, "left" takes for ever.
"""

from __future__ import annotations

import hashlib
import json
import struct
import time
import zlib
from pathlib import Path

from service.jobs.process import Reporter, Task

FACTS = {"exposure": 0.5, "effects": [], "left_out_costs_at_most": 0.0, "fallbacks": []}


def picture(request: dict[str, object]) -> bytes:
    """A grey PNG of one pixel whose text is the hash of the request."""

    def chunk(name: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))

    text = hashlib.sha256(json.dumps(request, sort_keys=True).encode()).hexdigest()
    head = struct.pack(">IIBBBBB", 1, 1, 8, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"tEXt", b"Request\0" + text.encode())
        + chunk(b"IDAT", zlib.compress(b"\0\x80")) + chunk(b"IEND", b"")
    )  # fmt: skip


def run(task: Task, reporter: Reporter) -> None:
    """Write the picture, or do what the view says.

    Raises:
        RuntimeError: on request.
    """
    request = task.options["request"]
    if request.get("view") == "back":
        raise RuntimeError("a secret path: /etc/shadow")
    while request.get("view") == "left":
        time.sleep(1)
    Path(task.output).write_bytes(picture(request))
    reporter.done(FACTS)
