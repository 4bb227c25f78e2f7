from __future__ import annotations

import json
import re

import pytest
import typer

from service import errors
from service.cli.app import reported
from service.errors import AvatarError


def tree(root: type[AvatarError] = AvatarError) -> list[type[AvatarError]]:
    return [root, *(leaf for branch in root.__subclasses__() for leaf in tree(branch))]


def test_the_drawn_tree_is_the_tree() -> None:
    """The picture at the top of errors.py names every class."""
    assert errors.__doc__
    names = {kind.__name__ for kind in tree() if kind.__module__ == errors.__name__}
    assert names <= set(re.findall(r"\w+", errors.__doc__))


def test_a_bug_ends_with_one_and_a_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(typer.Exit) as leaving, reported(as_json=True):
        raise ZeroDivisionError("depth was 0")
    out, err = capsys.readouterr()
    assert leaving.value.exit_code == 1
    assert "Traceback" in err
    assert json.loads(out)["error"] == {"code": "internal", "message": "ZeroDivisionError: depth was 0"}


def test_control_c_ends_with_130(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(typer.Exit) as leaving, reported(as_json=False):
        raise KeyboardInterrupt
    assert leaving.value.exit_code == 130
    assert "Traceback" not in capsys.readouterr().err


CONTRACT = {"UsageError": 2, "NoUsableFace": 3, "UnreadableInput": 4}
"""Exit statuses by branch of the tree; every other fault ends with 1."""


def promised(kind: type[AvatarError]) -> int:
    return next((CONTRACT[base.__name__] for base in kind.__mro__ if base.__name__ in CONTRACT), 1)


@pytest.mark.parametrize("kind", tree(), ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("as_json", [False, True])
def test_every_fault_leaves_by_its_own_status(
    kind: type[AvatarError], as_json: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(typer.Exit) as leaving, reported(as_json=as_json):
        raise kind("side is 3; at least 64 is needed", boxes=[[1, 2, 3, 4]])
    assert leaving.value.exit_code == promised(kind)
    out, err = capsys.readouterr()
    assert err == "avatarme: side is 3; at least 64 is needed\n", "one sentence, no traceback: this is no bug"
    if as_json:
        fault = json.loads(out)["error"]
        assert fault == {"boxes": [[1, 2, 3, 4]], "code": kind.code, "message": "side is 3; at least 64 is needed"}
    else:
        assert out == "", "standard output is for results"
