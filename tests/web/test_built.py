"""The built files as they lie in the repository."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
WEB = ROOT / "web"
STATIC = ROOT / "service" / "web" / "static"


class Tags(HTMLParser):
    """All start tags of the page."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed((STATIC / "index.html").read_text("utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))


def built() -> list[Path]:
    return sorted(path for path in STATIC.rglob("*") if path.is_file())


def test_the_page_is_small() -> None:
    sizes = {path.relative_to(STATIC).as_posix(): path.stat().st_size for path in built()}
    pictures = {name: size for name, size in sizes.items() if name.endswith(".jpg")}
    texts = {name: size for name, size in sizes.items() if name not in pictures}
    assert set(texts) == {"index.html", "app.js", "app.css", "viewer.js", "icon.svg", "LICENSES.txt"}
    assert sum(texts.values()) < 1_000_000
    assert sum(size for name, size in texts.items() if name != "viewer.js") < 60_000, "the first screen has no three.js"
    assert all(size < 70_000 for size in pictures.values())
    assert sum(pictures.values()) < 300_000


def test_every_picture_is_shown_and_every_shown_picture_is_there() -> None:
    shown = {attributes["src"] for tag, attributes in Tags().found if tag == "img" and attributes.get("src")}
    there = {path.relative_to(STATIC).as_posix() for path in built() if path.suffix in (".jpg", ".svg")}
    assert shown == there - {"sample.jpg"}, "sample.jpg is handed in, not shown"


def test_nothing_comes_from_another_server_and_nothing_is_inline() -> None:
    """A content delivery network would learn who uses the service; the content security policy would block the rest."""
    for tag, attributes in Tags().found:
        for name in ("src", "href"):
            assert not re.match(r"(\w+:)?//|javascript:", attributes.get(name) or ""), f"{tag} {name}"
        assert tag != "style" and (tag != "script" or attributes.get("src"))
        assert not [name for name in attributes if name == "style" or name.startswith("on")], tag
    assert not re.search(r"@import|url\(", (STATIC / "app.css").read_text("utf-8"))


def test_every_control_has_a_name() -> None:
    """A label, or text inside: what a screen reader says."""
    found = Tags().found
    labelled = {attributes.get("for") for tag, attributes in found if tag == "label"}
    for tag, attributes in found:
        if tag == "img":
            assert "alt" in attributes
        if tag == "input" and attributes.get("type") not in ("radio", "checkbox"):
            assert attributes.get("id") in labelled or attributes.get("aria-label")
    assert ("html", {"lang": "en"}) in found


def test_versions_are_exact_and_licences_are_shipped() -> None:
    package = json.loads((WEB / "package.json").read_text("utf-8"))
    versions = {**package["dependencies"], **package["devDependencies"]}
    assert all(re.fullmatch(r"\d+\.\d+\.\d+", version) for version in versions.values())
    locked = json.loads((WEB / "package-lock.json").read_text("utf-8"))["packages"]
    assert {name: locked[f"node_modules/{name}"]["version"] for name in versions} == versions
    assert all("integrity" in entry for name, entry in locked.items() if name)
    licences = (STATIC / "LICENSES.txt").read_text("utf-8")
    three = package["dependencies"]["three"]
    assert f"three.js {three}" in licences
    assert "The MIT License" in licences
    assert "public domain" in licences, "where the pictures come from"
    assert f"three.js {three}" in (ROOT / "THIRD_PARTY.md").read_text("utf-8")


@pytest.mark.slow
def test_the_built_files_are_those_of_the_sources(tmp_path: Path) -> None:
    if not shutil.which("node") or not (WEB / "node_modules" / "esbuild").is_dir():
        pytest.skip("the page's build tools are not installed: make web")
    environment = {**os.environ, "WEB_OUT": f"{tmp_path.as_uri()}/"}
    subprocess.run(["node", "build.mjs"], cwd=WEB, env=environment, check=True, capture_output=True)
    for path in built():
        again = tmp_path / path.relative_to(STATIC)
        assert again.read_bytes() == path.read_bytes(), f"{path.name} is old: run make web"
