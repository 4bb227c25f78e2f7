"""The repository as a whole: packaging, make targets, licences of data files, nothing of anybody's machine."""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import tomllib
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from service import __version__, diagnosis

ROOT = Path(__file__).parents[1]
DATA = ROOT / "service" / "data"


def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))


def data_files() -> list[Path]:
    return sorted(path for path in DATA.rglob("*") if path.is_file() and path != DATA / diagnosis.SUMS)


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def third_party_rows() -> dict[str, list[str]]:
    rows = {}
    for line in (ROOT / "THIRD_PARTY.md").read_text("utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if len(cells) == 5 and cells[0].startswith("`"):
            rows[cells[0].strip("`")] = cells[1:]
    return rows


def requirement_name(requirement: str) -> str:
    match = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert match, requirement
    return match[0].lower().replace("_", "-")


def locked() -> dict[str, str]:
    lines = (ROOT / "requirements.lock").read_text("utf-8").splitlines()
    pairs = [line.partition(" ;")[0].split("==") for line in lines if "==" in line and not line.startswith("#")]
    return {requirement_name(name): version for name, version in pairs}


def test_the_version_is_one() -> None:
    assert metadata.version("avatarme") == __version__
    assert re.fullmatch(r"\d+\.\d+\.\d+", __version__)
    released = re.findall(r"^## \[(\d+\.\d+\.\d+)\]", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert released[:1] in ([], [__version__]), "the newest release in CHANGELOG.md is not the version of the package"


def test_serving_needs_no_torch() -> None:
    names = {requirement_name(requirement) for requirement in project()["project"]["dependencies"]}
    assert not names & {"torch", "tensorflow", "anny", "mitsuba", "onnx"}
    assert set(diagnosis.REQUIRED) <= names


def test_the_lock_covers_serving_and_development() -> None:
    wanted = project()["project"]
    requirements = wanted["dependencies"] + wanted["optional-dependencies"]["dev"]
    assert not {requirement_name(requirement) for requirement in requirements} - set(locked())


@pytest.mark.parametrize("target", ["help", "setup", "run", "doctor", "test", "lint"])
def test_make_knows_the_target_and_help_tells(target: str) -> None:
    subprocess.run(["make", "--dry-run", target], cwd=ROOT, check=True, capture_output=True)
    listing = subprocess.run(["make", "help"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    assert re.search(rf"^ *make {target} ", listing, re.MULTILINE)


def test_every_data_file_has_a_licence_and_its_checksum() -> None:
    rows = third_party_rows()
    names = {str(path.relative_to(ROOT)) for path in data_files()}
    # Written here, under the licence of the code.
    ours = {name for name in names if name.endswith(".json") or name.startswith("service/data/kits/")}
    assert names - ours == set(rows), "THIRD_PARTY.md and service/data do not list the same files"
    for name, (source, licence, digest, redistributable) in rows.items():
        assert source, name
        assert licence, name
        assert redistributable.startswith("yes"), f"{name} must not be shipped"
        assert digest.strip("`") == sha256(ROOT / name), f"{name} is not the file of THIRD_PARTY.md"


def test_what_is_not_ours_is_free_and_in_the_notice() -> None:
    free = re.compile(r"(CC0-1\.0|MIT|BSD-[23]-Clause|Apache-2\.0|public domain)\b")
    notice = (ROOT / "NOTICE").read_text("utf-8")
    for name, (source, licence, *_) in third_party_rows().items():
        assert free.match(licence), f"{name} is under {licence}"
        if not source.startswith("ours"):
            folder, _, file = name.removeprefix("service/data/").partition("/")
            assert file in notice or f"service/data/{folder})" in notice, f"{name} is not in NOTICE"


def test_the_checksum_list_is_that_of_the_data_files() -> None:
    listed = diagnosis.shipped_files()
    assert listed == {path.relative_to(DATA).as_posix(): sha256(path) for path in data_files()}, "run make checksums"


def tracked_text() -> dict[str, str]:
    """Files that git knows and that are text; where there is no git (a source archive), all that lie here."""
    if (ROOT / ".git").exists():
        listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True).stdout
        paths = [ROOT / os.fsdecode(name) for name in listing.split(b"\0") if name]
    else:
        folders = ("service", "models", "export", "benchmarks", "tests")
        paths = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    texts = {}
    for path in paths:
        data = path.read_bytes() if path.is_file() else b""
        if b"\0" not in data:
            texts[str(path.relative_to(ROOT))] = data.decode("utf-8", "replace")
    return texts


def test_no_path_of_anybodys_machine() -> None:
    """A path under a home or work folder works for one person only."""
    private = re.compile(r"(?<![\w.$}])/(?:work|home|root|Users|tmp|opt)/\w")
    found = [f"{name}: {match[0]}" for name, text in tracked_text().items() for match in private.finditer(text)]
    assert not found


def test_docs_name_files_and_commands_that_there_are() -> None:
    """Whoever follows a page has to arrive; the changelog may tell of what has gone."""
    missing = []
    for page, text in tracked_text().items():
        if not page.endswith(".md") or page == "CHANGELOG.md":
            continue
        paths = re.findall(r"`((?:service|models|export|benchmarks|tests|docs|web)/[\w./-]*)`", text)
        missing += [f"{page}: {path}" for path in paths if not (ROOT / path).exists()]
        for name in re.findall(r"python -m ((?:service|models|export|benchmarks|tests)[\w.]*\w)", text):
            place = ROOT / name.replace(".", "/")
            if not place.with_suffix(".py").exists() and not (place / "__main__.py").exists():
                missing.append(f"{page}: python -m {name}")
    assert not missing


def test_no_private_key_and_no_large_file() -> None:
    for name, text in tracked_text().items():
        assert not re.search(r"-----BEGIN [A-Z ]*PRIVATE KEY", text), name
        assert len(text) < 2_000_000, f"{name}: text this long is data; it belongs in a data file"
