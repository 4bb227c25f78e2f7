"""What training never sees is decided by subject and light, not by patch or order."""

import pytest

pytest.importorskip("torch")

from models.lightstage import split
from models.lightstage.poses import EXPRESSIONS
from models.lightstage.skin.subject import Subject

pytestmark = pytest.mark.train


@pytest.fixture(scope="module")
def listed() -> list[split.Capture]:
    return split.captures()


def test_every_subject_is_in_one_part_with_seven_expressions(listed: list[split.Capture]) -> None:
    parts: dict[int, set[str]] = {}
    for capture in listed:
        parts.setdefault(capture.seed, set()).add(capture.part)
    assert len(parts) == 200
    assert len(EXPRESSIONS) == 7
    assert len(listed) == 1400
    assert all(len(p) == 1 for p in parts.values())


def test_corners_are_never_trained_on(listed: list[split.Capture]) -> None:
    corners = {s: split.corner(Subject.sample(s)) for s in {c.seed for c in listed}}
    assert all(c.part == split.HELD_OUT for c in listed if corners[c.seed] is not None)
    assert len({name for name in corners.values() if name}) >= 3  # the list reaches the corners at all
