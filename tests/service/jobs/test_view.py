"""What a job that failed says: the same object as an answer that refuses."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from service.errors import (
    AvatarError,
    FaceCutOff,
    FaceTooSmall,
    FitFailed,
    MultipleFaces,
    NoFace,
    NoUsableFace,
    UsageError,
)
from service.jobs.view import TITLES, from_error


def kinds(kind: type[AvatarError]) -> Iterator[type[AvatarError]]:
    for child in kind.__subclasses__():
        yield child
        yield from kinds(child)


@pytest.mark.parametrize(
    "error",
    [
        pytest.param(NoFace("none was found"), id="no-face"),
        pytest.param(MultipleFaces("there are two", boxes=[[0, 0, 9, 9], [20, 0, 29, 9]]), id="multiple-faces"),
        pytest.param(FaceTooSmall("it has 30 pixels", face_px=30), id="face-too-small"),
        pytest.param(FaceCutOff("half of it is outside"), id="face-cut-off"),
        pytest.param(FitFailed("it does not fit"), id="fit-failed"),
    ],
)
def test_a_photo_without_a_usable_face_ends_with_the_object_of_a_refusal(error: NoUsableFace) -> None:
    """With what a program needs to ask again: the boxes, the size."""
    found = from_error(error)
    assert (found["code"], found["status"]) == (error.code, 422)
    assert found["detail"] == error.message
    assert {name: found[name] for name in error.extra} == error.extra
    assert found["title"] == TITLES[error.code]
    assert found["type"] == f"/problems/{error.code}"


def test_the_field_of_a_wrong_option_is_a_pointer() -> None:
    found = from_error(UsageError("seed is -1", field="seed"))
    assert (found["pointer"], found["status"]) == ("/seed", 422)
    assert "field" not in found


def test_no_fault_of_the_server_tells_of_its_inside() -> None:
    """All kinds, those of later days too; the three that a job's owner can do something about speak for themselves."""
    told = set()
    for kind in kinds(AvatarError):
        found = from_error(kind("/secret/path", inside="/secret/path"))
        assert found["status"] == kind.http_status
        if kind.http_status >= 500 and "secret" in str(found):
            told.add(kind.code)
    assert told == {"crashed", "out-of-memory", "out-of-time"}
    assert "secret" not in str(from_error(ValueError("/secret/path")))
