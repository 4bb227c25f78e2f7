"""The file of hair, and what follows a head."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from service.anatomy.hair.item import read_items, write_items
from service.anatomy.hair.names import STYLES
from service.errors import ModelFault
from service.head.files import load_head

HEAD, ITEMS = load_head(), read_items()


def test_the_file_has_the_styles_that_the_option_names() -> None:
    assert tuple(name.partition("/")[2] for name in ITEMS.names("hair")) == STYLES
    assert len(ITEMS.names("brow")) == 12
    assert ITEMS.names("lash") and ITEMS.names("bust") == ["bust/body"]


@pytest.mark.parametrize("name", sorted(ITEMS.items))
def test_items_are_sound(name: str) -> None:
    item = ITEMS.items[name]
    assert item.triangles.min() >= 0 and item.triangles.max() == len(item.rest) - 1
    assert item.follow.min() >= 0 and item.follow.max() < len(HEAD.mean)
    np.testing.assert_allclose(item.share.sum(1), 1.0, atol=0.005)
    assert np.abs(item.rest).max() < 0.5
    if name.startswith("hair/"):
        assert item.picture.shape == (512, 512, 2) and item.along is not None
        assert 0 <= item.along.min() < 0.01 and item.along.max() == 1.0


@pytest.mark.parametrize("name", ["hair/long01", "lash/eyelashes02", "bust/body"])
def test_a_head_that_moves_takes_its_things_along(name: str) -> None:
    item, shift = ITEMS.items[name], np.array([0.01, -0.02, 0.03], np.float32)
    moved = item.worn(np.broadcast_to(shift, HEAD.mean.shape))
    np.testing.assert_allclose(moved, item.rest + shift, atol=2e-4)


def test_the_bust_is_the_heads_own_neck_where_they_meet() -> None:
    from service.anatomy.hair.bust import seam

    item = ITEMS.items["bust/body"]
    own, of = seam(item)
    assert len(own) >= 40
    neutral = HEAD.shape(np.array([1.5, -1.0, 0.5]))
    worn = item.worn(neutral - ITEMS.fitted_head)
    assert np.abs(worn[own] - neutral[of]).max() < 3e-5


def test_a_file_comes_back_as_it_was_written(tmp_path: Path) -> None:
    items = [ITEMS.items["hair/short04"], ITEMS.items["bust/body"]]
    for path in (tmp_path / "a.npz", tmp_path / "b.npz"):
        write_items(items, ITEMS.fitted_head, path)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    again = read_items(tmp_path / "a.npz").items["hair/short04"]
    np.testing.assert_allclose(again.rest, items[0].rest, atol=1e-5)
    assert np.array_equal(again.picture, items[0].picture) and np.array_equal(again.triangles, items[0].triangles)


def test_a_missing_or_torn_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelFault, match="missing"):
        read_items(tmp_path / "none.npz")
    (tmp_path / "torn.npz").write_bytes(b"PK\x03\x04 torn")
    with pytest.raises(ModelFault, match="cannot be read"):
        read_items(tmp_path / "torn.npz")
