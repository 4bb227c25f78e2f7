"""A turntable: as many pictures, one scale, films that open."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image, ImageSequence

from service.archive.pack import write_archive
from service.archive.rendering import turntable
from service.errors import UsageError
from service.render.request import RenderRequest
from tests.service.archive.toys import whole_avatar

SMALL = RenderRequest(size=(64, 80), samples=1, tolerance=200.0)


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("turn") / "toy.zip"
    write_archive(whole_avatar(), path)
    return path


def test_a_gif_has_the_pictures(archive: Path, tmp_path: Path) -> None:
    told: list[float] = []
    size = turntable(archive, tmp_path / "a.gif", SMALL, 3, lambda name, done: told.append(done))
    with Image.open(tmp_path / "a.gif") as film:
        assert len(list(ImageSequence.Iterator(film))) == 3 and film.size == (64, 80) and film.info["loop"] == 0
        frames = []
        for index in range(3):
            film.seek(index)
            frames.append(np.asarray(film.convert("RGB"), float))
    assert size == (tmp_path / "a.gif").stat().st_size
    assert np.abs(frames[0] - frames[1]).mean() > 1, "it turns"
    assert told == sorted(told) and len(told) == 4


def test_an_mp4_opens(archive: Path, tmp_path: Path) -> None:
    turntable(archive, tmp_path / "a.mp4", SMALL, 2)
    film = cv2.VideoCapture(str(tmp_path / "a.mp4"))
    assert int(film.get(cv2.CAP_PROP_FRAME_COUNT)) == 2
    assert (film.get(cv2.CAP_PROP_FRAME_WIDTH), film.get(cv2.CAP_PROP_FRAME_HEIGHT)) == (64, 80)


@pytest.mark.parametrize(
    ("name", "count", "request_", "said"),
    [
        ("a.avi", 3, SMALL, "a.avi"), ("a.gif", 1, SMALL, "turntable is 1"), ("a.gif", 1000, SMALL, "1000"),
        ("a.mp4", 3, RenderRequest(size=(65, 80)), "65x80"),
        ("a.gif", 3, RenderRequest(size=(64, 80), background="transparent"), "transparent"),
    ],
)  # fmt: skip
def test_what_cannot_be_filmed(
    archive: Path, tmp_path: Path, name: str, count: int, request_: RenderRequest, said: str
) -> None:
    with pytest.raises(UsageError, match=said):
        turntable(archive, tmp_path / name, request_, count)
