"""The log of a process, seen from outside."""

from __future__ import annotations

import json
import subprocess
import sys
import time

from service.jobs import logs


def test_nobody_waits_for_a_log_that_is_not_read() -> None:
    """A pipe that nobody reads holds 64 KiB; this is a hundred times as much."""
    program = """
import logging
from service.jobs import logs
logs.set_up()
for number in range(30_000):
    logging.getLogger("x").info("line %d of a log that nobody reads " + "." * 200, number)
print("through", flush=True)
"""
    begin = time.monotonic()
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"through\n"
        child.kill()
    assert time.monotonic() - begin < 20


def test_the_last_words_of_a_process_are_written() -> None:
    program = """
import logging, os
from service.jobs import logs
logs.set_up()
log = logging.getLogger("x")
log.info("before")
log.info("%d", "a mistake in a message")
try:
    1 / 0
except ZeroDivisionError:
    log.critical("the end", exc_info=True)
os._exit(75)
"""
    run = subprocess.run([sys.executable, "-c", program], check=False, capture_output=True, text=True)
    lines = [json.loads(line) for line in run.stderr.splitlines()]
    assert run.returncode == 75
    assert [line["message"] for line in lines][::2] == ["before", "the end"]
    assert "ZeroDivisionError" in lines[-1]["traceback"]


def test_a_log_that_is_closed_stops_nothing() -> None:
    program = "import logging; from service.jobs import logs; logs.set_up(); logging.critical('x'); print('through')"
    command = f'{sys.executable} -c "{program}" 2>&-'
    begin = time.monotonic()
    assert subprocess.run(["sh", "-c", command], check=True, capture_output=True).stdout == b"through\n"
    assert time.monotonic() - begin < 2 * logs.PATIENCE, "the thread of the log has died"
