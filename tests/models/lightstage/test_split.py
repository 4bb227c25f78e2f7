"""What training never sees is decided by subject and light, not by patch or order."""

import pytest

pytest.importorskip("torch")

from models.lightstage import split
from models.lightstage.poses import EXPRESSIONS, expression
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


def test_shares_are_sensible(listed: list[split.Capture]) -> None:
    share = sum(c.part == split.HELD_OUT for c in listed) / len(listed)
    assert 0.1 < share < 0.35


def test_corners_are_never_trained_on(listed: list[split.Capture]) -> None:
    corners = {s: split.corner(Subject.sample(s)) for s in {c.seed for c in listed}}
    assert all(c.part == split.HELD_OUT for c in listed if corners[c.seed] is not None)
    assert len({name for name in corners.values() if name}) >= 3  # the list reaches the corners at all


def test_parts_do_not_depend_on_the_list() -> None:
    assert [c.part for c in split.captures(5, 1010)] == [c.part for c in split.captures(15, 1000)[70:]]


def test_lights_are_split_by_name() -> None:
    parts = [split.light_part(f"procedural-{i}") for i in range(400)]
    assert 0.08 < parts.count(split.HELD_OUT) / 400 < 0.24
    assert split.light_part("studio") == split.light_part("studio")


def test_expressions_are_personal_and_bounded() -> None:
    assert expression("neutral", 3) == {}
    assert expression("smile", 3) != expression("smile", 4)
    assert all(0.0 <= v <= 1.0 for name in EXPRESSIONS for v in expression(name, 5).values())
    with pytest.raises(KeyError, match="smile"):
        expression("grin", 3)
