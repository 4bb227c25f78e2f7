"""OpenVINO, which only Linux on x86-64 installs by default: the only file that imports it."""

from __future__ import annotations

import importlib.util
import sys
from functools import lru_cache
from typing import Any

REPORTER = "openvino_telemetry"


@lru_cache(maxsize=1)
def has_openvino() -> bool:
    """Whether OpenVINO is installed."""
    return importlib.util.find_spec("openvino") is not None


@lru_cache(maxsize=1)
def openvino_library() -> Any:
    """OpenVINO, imported at first use.

    Left alone, its import makes up a client id, keeps it in the user's home, and forks a process that reports to its
    makers; a fork beside another thread's matrix product can also hang the program. It does without where its package
    for that is missing, so it is told that it is. This program talks to nobody.
    """
    sys.modules.setdefault(REPORTER, None)  # type: ignore[arg-type]  # None makes an import fail
    import openvino

    return openvino
