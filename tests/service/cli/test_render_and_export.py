"""``avatarme render``: files, pipes, and what is said when something is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from service.archive.pack import write_archive
from service.archive.reading import open_avatar
from service.cli.app import app
from service.render.render import RenderedPicture, render_head
from service.render.request import RenderRequest
from service.render.surface import ROLES
from tests.service.archive.toys import toy_avatar
from tests.service.render.toys import ROUGH


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("render") / "toy.zip"
    write_archive(toy_avatar(), path)
    return path


@pytest.fixture(autouse=True)
def rough(monkeypatch: pytest.MonkeyPatch) -> None:
    def render_archive(source: Any, request: RenderRequest) -> RenderedPicture:
        avatar = open_avatar(source, ROLES)
        head = avatar.mesh.as_head("toy", "CC0-1.0")
        return render_head(head, avatar.mesh.vertices, avatar.maps, request, threads=1, detail=ROUGH)

    monkeypatch.setattr("service.archive.rendering.render_archive", render_archive)


def run(*arguments: object, data: bytes = b"") -> Any:
    return CliRunner().invoke(app, ["render", *map(str, arguments)], input=data)


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (("nothing.zip", "-o", "x.png"), 2, "nothing.zip"),
        (("{archive}", "-o", "x.png", "--scene", "nothing.json"), 2, "nothing.json"),
        (("{archive}", "-o", "x.png", "--scene", "{bad}"), 2, "strength"),
        (("{archive}", "-o", "x.png", "--size", "10x10"), 2, "16 to 4096"),
        (("{archive}", "-o", "x.png", "--size", "big"), 2, "big"),
        (("{archive}", "-o", "x.png", "--view", "sideways"), 2, "sideways"),
        (("{archive}", "-o", "-", "--json"), 2, "--json"),
        (("{archive}", "-o", "{archive}"), 2, "would be overwritten"),
        (("-", "--scene", "-", "-o", "x.png"), 2, "both"),
        (("{bad}", "-o", "x.png"), 4, "archive"),
        (("{archive}", "-o", "{folder}/no/x.png"), 1, "cannot write"),
        (("{archive}", "-o", "x.JPG"), 2, "x.JPG would not be what its name says: the picture is a .png"),
        (("{archive}", "-o", "x.mp4"), 2, "IMAGE.png"),
        (("{archive}", "-o", "x.png", "--turntable", "3"), 2, "the film is a .mp4"),
        (("{archive}", "-o", "x.png", "--scene", "{dark}"), 2, "the scene has no light"),
        (("{bad}", "-o", "{folder}/no/x.png"), 1, "cannot write"),  # before the work
    ],
)
def test_what_is_wrong_is_said(
    arguments: tuple[str, ...], status: int, words: str, archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bad = tmp_path / "bad.json"
    bad.write_text('{"environment": {"strength": -1}}')
    dark = tmp_path / "dark.json"
    dark.write_text('{"viewpoints": [[0, 0, 1]]}')
    monkeypatch.chdir(tmp_path)
    filled = [each.format(archive=archive, bad=bad, dark=dark, folder=tmp_path) for each in arguments]
    sized = filled if "--size" in filled else [*filled, "--size", "24x24", "--samples", "1"]
    result = run(*sized)
    assert result.exit_code == status, result.output
    assert words in result.stderr
    assert not (tmp_path / "x.png").exists()
