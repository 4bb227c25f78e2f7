"""Which room may import which, that no import leads back, and what must never be imported."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

NOT_IN_SERVICE = {"torch", "torchvision", "tensorflow", "anny", "onnx", "onnxscript", "mitsuba", "pytest"}
"""Training, conversion and test libraries: gigabytes that no machine that serves should need."""

ORDER = {
    "service": (
        # What everything stands on.
        "errors", "words", "machine", "places", "manifest", "arrays", "robust", "checks", "stage_cache",
        "levels", "map_registry", "image_filters", "colour", "corrections", "diagnosis", "photo", "head", "geometry",
        "materials", "runtime",
        # From the photo to the maps, and their files.
        "light", "render", "face", "hair", "anatomy", "texture", "reflectance", "archive",
        # The whole way, and who asks for it.
        "kits", "options", "budget", "likeness", "ahead", "pipeline", "jobs", "bench", "external", "api",
        "client", "batch", "cli", "__main__",
    ),
    "models": ("drawing", "colour", "tables", "networks", "lightstage", "head", "hair", "people", "training"),
    "export": ("faces", "networks", "light"),
}  # fmt: skip
"""The rooms of each package, lower ones first: a room imports itself and those before it, never one behind it.

A room is a folder or a module with all that lies in it; of two that fit the longer name holds.
"""

CORE = ORDER["service"][: ORDER["service"].index("archive") + 1]
"""What training and conversion share with serving: numpy on arrays and files, no jobs, no API, no command line."""

_ABOVE_THE_CORE = {f"service.{room}" for room in ORDER["service"] if room not in CORE}

ENGINE_OF_BATCHES = ("service.batch.", "service.jobs.process.", "service.jobs.database.")
"""What draws data for training too, for ``models/drawing.py`` alone."""

FORBIDDEN = {
    "service": {"models", "export", "benchmarks", "tests", *NOT_IN_SERVICE},
    "models": {"export", "benchmarks", "tests", *_ABOVE_THE_CORE},
    "export": {"benchmarks", "tests", *_ABOVE_THE_CORE},
    "benchmarks": {f"tests.{room.name}" for room in (ROOT / "tests").iterdir() if room.stem != "support"},
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
    names = found.get("models/drawing.py", [])
    found["models/drawing.py"] = [name for name in names if not name.startswith(ENGINE_OF_BATCHES)]
    assert not {file: names for file, names in found.items() if names}


@pytest.mark.parametrize(
    "source", ["import torch", "from torch import nn", "def f():\n    import torch.nn", "from service.cli import app"]
)
def test_the_check_sees_a_trespass(source: str) -> None:
    assert trespasses(source, {"torch", "service.cli"})


def module_name(file: Path) -> str:
    return ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def imports_between(sources: Mapping[str, str]) -> dict[str, set[str]]:
    """Modules of ours that each module imports: in functions and for type checkers only, too."""
    found: dict[str, set[str]] = {name: set() for name in sources}
    for name, source in sources.items():
        for imported in imported_names(source):
            while imported and imported not in sources:
                imported = imported.rpartition(".")[0]
            # A folder's empty __init__ is no module that anything depends on.
            if imported and imported != name and sources[imported].strip():
                found[name].add(imported)
    return found


def room_of(module: str) -> str | None:
    """Package and room, as "service.photo"; None for a module without a room."""
    package = module.partition(".")[0]
    fitting = [room for room in ORDER.get(package, ()) if f"{module}.".startswith(f"{package}.{room}.")]
    return f"{package}.{max(fitting, key=len)}" if fitting else None


def trespasses_up(imports: Mapping[str, set[str]]) -> set[str]:
    """Imports of a room that stands behind the importing module's own, in the same package."""
    place = {f"{package}.{room}": at for package, rooms in ORDER.items() for at, room in enumerate(rooms)}
    found = set()
    for module, others in imports.items():
        own = room_of(module)
        for other in others:
            room = room_of(other)
            same = module.partition(".")[0] == other.partition(".")[0]
            if own and room and same and place[room] > place[own]:
                found.add(f"{module} imports {other}")
    return found


def circles(imports: Mapping[str, set[str]]) -> set[frozenset[str]]:
    """Sets of modules of which each one leads to each other one."""
    left = {module: set(others) for module, others in imports.items()}
    while loose := {module for module, others in left.items() if not others & set(left)}:
        left = {module: others for module, others in left.items() if module not in loose}

    def reached(start: str) -> set[str]:
        seen: set[str] = set()
        waiting = [start]
        while waiting:
            new = (left[waiting.pop()] & set(left)) - seen
            seen |= new
            waiting += new
        return seen

    leads_to = {module: reached(module) for module in left}
    return {
        frozenset(other for other in leads_to[module] if module in leads_to[other])
        for module in left
        if module in leads_to[module]
    }


@pytest.fixture(scope="module")
def imports() -> dict[str, set[str]]:
    """What the modules of service, models and export import of each other."""
    files = sorted(file for package in ORDER for file in (ROOT / package).rglob("*.py"))
    return imports_between({module_name(file): file.read_text("utf-8") for file in files})


def test_every_module_has_a_room_and_every_room_exists(imports: dict[str, set[str]]) -> None:
    rooms = {module: room_of(module) for module in imports if "." in module}
    assert not [module for module, room in rooms.items() if room is None], "give it a place in ORDER"
    assert {f"{package}.{room}" for package in ORDER for room in ORDER[package]} == set(rooms.values())


def test_lower_rooms_import_no_higher_ones(imports: dict[str, set[str]]) -> None:
    assert trespasses_up(imports) == set()


def test_no_module_leads_back_to_itself(imports: dict[str, set[str]]) -> None:
    assert circles(imports) == set()


@pytest.mark.parametrize(
    ("module", "source", "trespass"),
    [
        ("service.geometry.chart", "from service.texture.texture import complete", True),
        ("service.geometry.chart", "def f():\n    import service.texture.texture", True),
        ("service.runtime.networks", "from service.budget import measure", True),
        ("service.budget", "from service.runtime.networks import Engine", False),
        ("service.texture.texture", "from service.geometry.chart import Chart", False),
    ],
)
def test_the_check_sees_who_imports_a_higher_room(module: str, source: str, trespass: bool) -> None:
    names = ("service.geometry.chart", "service.texture.texture", "service.runtime.networks", "service.budget")
    sources = {**dict.fromkeys(names, "pass"), module: source}
    assert bool(trespasses_up(imports_between(sources))) is trespass


def test_the_check_sees_a_circle_and_no_other() -> None:
    chain = {"a": {"b"}, "b": {"c"}, "c": {"b", "d"}, "d": set(), "e": {"e"}}
    assert circles(chain) == {frozenset("bc"), frozenset("e")}
    assert not circles({"a": {"b", "c"}, "b": {"c"}, "c": set()})


FETCHERS = {"httpx", "httpcore", "requests", "aiohttp", "urllib3", "urllib.request", "http.client", "service.client"}
"""Whatever fetches from an address."""


def test_what_serves_fetches_nothing() -> None:
    """A server without an HTTP client cannot be talked into asking an address of a stranger's choice.

    One module posts: to hosts that the operator has listed, to the address that was checked, and it reads no answer.
    """
    clients = {ROOT / "service" / "client", ROOT / "service" / "batch"}
    files = [file for file in sorted((ROOT / "service").rglob("*.py")) if not clients & set(file.parents)]
    files.remove(ROOT / "service" / "jobs" / "webhooks.py")
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
    listed = "print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    program = f"import sys; from service.cli.app import app; app(['--help'], standalone_mode=False); {listed}"
    child = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    heavy = {"numpy", "scipy", "cv2", "onnxruntime", "PIL", "trimesh", "rich", "httpx"}
    assert not heavy & set(child.stdout.split())
