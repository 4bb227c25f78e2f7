"""Who may import whom, and what must never be imported."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

NOT_IN_SERVICE = {"torch", "torchvision", "tensorflow", "anny", "onnx", "onnxscript", "mitsuba", "pytest"}
"""Training, conversion and test libraries: gigabytes that no machine that serves should need."""

FORBIDDEN = {
    "service": {"models", "export", "benchmarks", "tests", *NOT_IN_SERVICE},
    "models": {"export", "benchmarks", "tests", "service.cli", "service.http", "service.jobs"},
    "export": {"benchmarks", "tests", "service.cli", "service.http", "service.jobs"},
    "benchmarks": {"tests"},
}


def imported_names(source: str) -> Iterator[str]:
    """Dotted names of all imports, those inside functions too."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import: the house writes absolute ones"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def trespasses(source: str, forbidden: set[str]) -> list[str]:
    return [name for name in imported_names(source) if any(f"{name}.".startswith(f"{ban}.") for ban in forbidden)]


@pytest.mark.parametrize("package", FORBIDDEN)
def test_imports_run_one_way(package: str) -> None:
    files = sorted((ROOT / package).rglob("*.py"))
    assert files, f"no modules under {package}/"
    found = {str(file.relative_to(ROOT)): trespasses(file.read_text("utf-8"), FORBIDDEN[package]) for file in files}
    assert not {file: names for file, names in found.items() if names}


@pytest.mark.parametrize(
    "source", ["import torch", "from torch import nn", "def f():\n    import torch.nn", "from service.cli import app"]
)
def test_the_check_sees_a_trespass(source: str) -> None:
    assert trespasses(source, {"torch", "service.cli"})


def test_the_check_knows_names_from_prefixes() -> None:
    assert not trespasses("import torchlike\nfrom service.client import x", {"torch", "service.cli"})


FETCHERS = {"httpx", "httpcore", "requests", "aiohttp", "urllib3", "urllib.request", "http.client", "service.client"}
"""Whatever fetches from an address."""


def test_what_serves_fetches_nothing() -> None:
    """A server without an HTTP client cannot be talked into asking an address of a stranger's choice.

    One module posts: to hosts that the operator has listed, to the address that was checked, and it reads no answer.
    """
    clients = {ROOT / "service" / "client", ROOT / "service" / "batch"}
    files = [file for file in sorted((ROOT / "service").rglob("*.py")) if not clients & set(file.parents)]
    files.remove(ROOT / "service" / "webhooks" / "post.py")
    found = {str(file.relative_to(ROOT)): trespasses(file.read_text("utf-8"), FETCHERS) for file in files}
    assert not {file: names for file, names in found.items() if names}


WALK = """
import importlib, importlib.abc, pkgutil, sys
refused = set(sys.argv[1].split(","))
tried = []

class Guard(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in refused:
            tried.append(name)
            raise ModuleNotFoundError(f"{name} is not part of the serving install", name=name)
        return None

sys.meta_path.insert(0, Guard())
import service
names = [module.name for module in pkgutil.walk_packages(service.__path__, "service.")]
for name in names:
    importlib.import_module(name)
assert not tried, tried
assert not refused & set(sys.modules), refused & set(sys.modules)
print(len(names))
"""


def test_service_imports_without_torch() -> None:
    """Every module under service, in a fresh interpreter in which torch and its like do not exist.

    Catches what the source check cannot: a library of ours that imports torch where it finds it.
    """
    child = subprocess.run(
        [sys.executable, "-c", WALK, ",".join(sorted(NOT_IN_SERVICE))], cwd=ROOT, capture_output=True, text=True
    )
    assert child.returncode == 0, child.stderr
    assert int(child.stdout) >= len(list((ROOT / "service").rglob("[a-z]*.py")))


def test_the_command_line_starts_without_numeric_libraries() -> None:
    """`avatarme --help` must not pay for numpy, OpenCV or onnxruntime."""
    program = "import sys, service.cli.app; print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    child = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    heavy = {"numpy", "scipy", "cv2", "onnxruntime", "PIL", "trimesh", "rich", "httpx"}
    assert not heavy & set(child.stdout.split())
