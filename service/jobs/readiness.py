"""Is everything there that a job needs?"""

from __future__ import annotations

import json
import subprocess
import sys

from service.jobs.settings import Settings

TIMEOUT = 300.0

_LOAD = """
import json, sys
faults = []
try:
    from service.diagnosis import data_faults
    faults += data_faults()
    if not faults:
        from service.head.files import load_head
        from service.runtime.sessions import load_session, model_table
        load_head()
        for name, entry in model_table().items():
            if str(entry["file"]).endswith(".onnx"):
                load_session(name)
except Exception as error:
    faults.append(f"{type(error).__name__}: {error}")
print(json.dumps(faults))
"""


def faults(settings: Settings) -> list[str]:
    """One sentence for each thing that is not well; empty when all is.

    Hashes of all data files are compared and all networks are loaded, in a process of its own: native code that
    crashes must not take the worker along, and loading brings the files into the system's cache.

    Args:
        settings: of the worker; where it runs another program than the pipeline, nothing is checked.
    """
    if settings.program != "service.jobs.child":
        return []
    try:
        process = subprocess.run(  # noqa: S603 - our own interpreter and our own code
            [sys.executable, "-c", _LOAD], capture_output=True, text=True, timeout=TIMEOUT, check=False
        )
    except subprocess.TimeoutExpired:
        return [f"loading the networks took more than {TIMEOUT:g} s"]
    lines = process.stdout.strip().splitlines()
    if process.returncode or not lines:
        return [f"loading the networks ended with status {process.returncode}"]
    return [str(fault) for fault in json.loads(lines[-1])]
