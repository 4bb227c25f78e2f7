"""Does a commit that only moves code change what is made? ``python -m tests.tools.same_bytes PHOTO... [--options ...]``

Prints the sha256 of the archive of every photo, made by the command of the tree that it is run in. Run it in the tree
before and in the tree after, and compare: ``diff <(cd BEFORE && ...) <(cd AFTER && ...)``.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tempfile
from pathlib import Path

SMALL = ["--quality", "draft", "--size", "384x256"]


def main(arguments: list[str]) -> None:
    """One line for each photo; a photo that is refused has the program's words instead."""
    cut = arguments.index("--options") if "--options" in arguments else len(arguments)
    options = arguments[cut + 1 :] or SMALL
    for photo in arguments[:cut]:
        with tempfile.TemporaryDirectory() as folder:
            target = Path(folder) / "avatar.zip"
            command = [sys.executable, "-m", "service", "make", photo, "-o", str(target), *options]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            said = hashlib.sha256(target.read_bytes()).hexdigest() if target.exists() else done.stderr.strip()
        print(f"{said}  {Path(photo).name}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
