"""What a groom is called, by how far it reaches and what was done to it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from service.hair.groom import make_groom
from service.hair.kinds import ends_m, kinds_of
from service.hair.style import NAMED


def kinds(name: str, **changes: object) -> dict[str, str]:
    style = dataclasses.replace(NAMED[name], **changes)  # type: ignore[arg-type]
    return kinds_of(style, make_groom(style, 1, 1500).strands)


@pytest.mark.parametrize(
    ("name", "asked", "choice"),
    [
        ("shaved", "length", "cropped"), ("crop", "length", "short"), ("side_part", "length", "short"),
        ("bob", "length", "jaw"), ("long_wavy", "length", "longer"), ("ponytail", "gathered", "tied"),
        ("bun", "gathered", "tied"), ("crop", "gathered", "none"), ("bob", "parting", "middle"),
        ("side_part", "parting", "left"), ("slicked_back", "parting", "none"), ("afro", "curl", "coily"),
        ("curly", "curl", "curly"), ("long_wavy", "curl", "wavy"), ("bob", "curl", "straight"),
        ("slicked_back", "fringe", "no"),
    ],
)  # fmt: skip
def test_a_hairdresser_would_agree(name: str, asked: str, choice: str) -> None:
    assert kinds(name)[asked] == choice


def test_what_hangs_ends_where_it_was_cut() -> None:
    style = dataclasses.replace(NAMED["bob"], layers=0.0)
    assert style.cut_y is not None
    assert ends_m(make_groom(style, 3, 1500).strands) == pytest.approx(style.cut_y, abs=0.02)


def test_a_head_without_strands_is_cropped_and_has_no_ends() -> None:
    none = np.zeros((0, 2, 3), np.float32)
    assert kinds_of(NAMED["bob"], none)["length"] == "cropped"
    assert np.isnan(ends_m(none))
