"""How many files one opens to follow four things through the program: ``python -m tests.tools.walks [TREE]``.

- a photo: modules of ``service`` of which some function runs while a draft of the sample is made and packed;
- an eye's colour: those of them whose code names an iris;
- a POSTed job: modules of ``service/api`` and ``service/jobs`` that route, worker and the job's process import;
- a network from training to serving: modules of ``models``, ``export`` and ``service`` that name ``rho``.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

RAN = """
import sys, threading
ran = set()
def note(frame, event, argument):
    if event == "call" and frame.f_code.co_name != "<module>":
        ran.add(frame.f_code.co_filename)
threading.setprofile(note)
sys.setprofile(note)
from service import diagnosis
from service.archive.pack import archive_members
from service.options import Options
from service.pipeline import make_avatar
archive_members(make_avatar(diagnosis.SAMPLE.read_bytes(), Options(quality="draft", size=(384, 256))))
sys.setprofile(None)
print("\\n".join(sorted(ran)))
"""


def names_in(file: Path) -> set[str]:
    """Identifiers and strings of a module, docstrings aside."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        for name in ("id", "attr", "arg", "name"):
            found.add(str(getattr(node, name, "")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " not in node.value:
            found.add(node.value)
    return found


def imported(root: Path, start: list[str]) -> set[Path]:
    """Modules of ``service`` that some lead to."""
    seen: set[Path] = set()
    waiting = [root / f"{name}.py" for name in start if (root / f"{name}.py").exists()]
    while waiting:
        file = waiting.pop()
        if file in seen:
            continue
        seen.add(file)
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("service"):
                base = root / str(node.module).replace(".", "/")
                places = [base.with_suffix(".py"), *((base / f"{alias.name}.py") for alias in node.names)]
                waiting += [place for place in places if place.exists()]
    return seen


def walks(root: Path) -> dict[str, int]:
    """Number of files of each walk."""
    done = subprocess.run([sys.executable, "-c", RAN], cwd=root, capture_output=True, text=True, check=True)
    photo = [Path(line) for line in done.stdout.split("\n") if "/service/" in line and Path(line).is_file()]
    inside = [file for file in photo if file.resolve().is_relative_to(root.resolve() / "service")]
    program = [file for name in ("models", "export", "service") for file in (root / name).rglob("*.py")]
    job = imported(root, ["service/api/avatars", "service/jobs/worker", "service/jobs/avatar_process"])
    return {
        "a photo": len(inside),
        "an eye's colour": sum(any("iris" in name.lower() for name in names_in(file)) for file in inside),
        "a POSTed job": sum(file.parent.name in ("api", "jobs") for file in job),
        "a network from training to serving": sum("rho" in names_in(file) for file in program),
    }


if __name__ == "__main__":
    for walk, files in walks(Path(sys.argv[1] if len(sys.argv) > 1 else ".")).items():
        print(f"{files:4d}  {walk}")
