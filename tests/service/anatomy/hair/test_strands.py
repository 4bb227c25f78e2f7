"""Directions of strands: those of stripes, whatever lies beside them, and those of a style as it is seen."""

from __future__ import annotations

import numpy as np
import pytest

from service.anatomy.hair.item import Item, read_items
from service.anatomy.hair.strands import agreement, drawn, in_photo, in_texture
from service.arrays import Float32

CELLS, FINER = 40, 2


def stripes(degrees: float, side: int = CELLS * FINER) -> Float32:
    """(side, side, 3) linear RGB, strands that run at an angle from the x axis towards +y."""
    y, x = np.mgrid[:side, :side].astype(np.float32)
    across = -np.sin(np.radians(degrees)) * x + np.cos(np.radians(degrees)) * y
    level = 0.05 * np.exp(0.5 * np.sin(across * 2 * np.pi / 5))
    return np.repeat(level[..., None], 3, 2).astype(np.float32)


def twice(degrees: float) -> Float32:
    angle = 2 * np.radians(degrees)
    return np.array([np.cos(angle), np.sin(angle)], np.float32)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 90.0, 135.0])
def test_strands_run_along_stripes(degrees: float) -> None:
    found = in_photo(stripes(degrees), np.ones((CELLS, CELLS), np.float32))
    middle = found[10:-10, 10:-10].reshape(-1, 2)
    assert (np.linalg.norm(middle, axis=1) > 0.8).all()
    assert (middle @ twice(degrees) > 0.8).all()


def test_an_even_patch_and_what_is_no_hair_have_no_direction() -> None:
    even = np.full((CELLS * FINER,) * 2 + (3,), 0.05, np.float32)
    assert np.abs(in_photo(even, np.ones((CELLS, CELLS), np.float32))).max() < 1e-3
    assert not in_photo(stripes(30.0), np.zeros((CELLS, CELLS), np.float32)).any()


def test_the_hairline_and_a_shade_are_no_strands() -> None:
    """A hairline is an edge stronger than strands, and a shade runs along it: both would look like hair across it."""
    pixels = stripes(90.0) * np.linspace(1.5, 0.5, CELLS * FINER, dtype=np.float32)[:, None, None]
    pixels[: CELLS * FINER // 2] = 0.6
    hair = np.zeros((CELLS, CELLS), np.float32)
    hair[CELLS // 2 :] = 1
    found = in_photo(pixels, hair)[CELLS // 2 + 2 : -4, 4:-4].reshape(-1, 2)
    assert (found @ twice(90.0) > 0.5).mean() > 0.95


def card(points: list[list[float]], uv: list[list[float]]) -> tuple[Item, Float32]:
    picture = np.zeros((64, 64, 2), np.uint8)
    picture[..., 0] = np.where(np.arange(64) % 6 < 3, 200, 120)[None]  # strands along v
    picture[..., 1] = 255
    flat = np.array(points, np.float32)
    rest = np.concatenate([flat, np.zeros((3, 1), np.float32)], 1)
    none = np.zeros((3, 1), np.float32)
    item = Item("hair/card", rest, none.astype(np.int32), none, np.array(uv, np.float32), np.array([[0, 1, 2]], np.int32), picture)  # noqa: E501  # fmt: skip
    return item, flat


def test_a_style_is_seen_with_the_strands_of_its_texture() -> None:
    uv = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
    thirds, first = np.full((1, 3), 1 / 3, np.float32), np.zeros(1, np.int64)
    upright, flat = card([[0.0, 0.0], [10.0, 0.0], [0.0, -10.0]], uv)
    assert drawn(upright, in_texture(upright.picture), flat, first, thirds)[0] @ twice(90.0) > 0.8
    turned, flat = card([[0.0, 0.0], [0.0, 10.0], [10.0, 0.0]], uv)  # v runs along x
    assert drawn(turned, in_texture(turned.picture), flat, first, thirds)[0] @ twice(0.0) > 0.8


def test_a_triangle_without_area_has_no_direction() -> None:
    thirds, first = np.full((1, 3), 1 / 3, np.float32), np.zeros(1, np.int64)
    for points, uv in (
        ([[0.0, 0.0], [10.0, 0.0], [0.0, -10.0]], [[0.5, 0.5]] * 3),
        ([[3.0, 3.0]] * 3, [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]),
    ):
        item, flat = card(points, uv)
        assert not drawn(item, in_texture(item.picture), flat, first, thirds).any()


def test_hair_combed_back_and_hair_that_hangs_run_across_each_other() -> None:
    """The textures of the styles have directions at all, which is what the choice lives from."""
    items = read_items()
    for name in ("hair/ponytail01", "hair/long01", "hair/short01"):
        picture = items.items[name].picture
        solid = picture[..., 1] > 200
        assert np.linalg.norm(in_texture(picture), axis=-1)[solid].mean() > 0.4, name


def test_agreement_is_that_of_directions() -> None:
    one = np.broadcast_to(twice(20.0), (50, 50, 2)).astype(np.float32)
    across = np.broadcast_to(twice(110.0), (50, 50, 2)).astype(np.float32)
    hair = np.ones((50, 50), np.float32)
    assert agreement(one, one, hair) > 0.95
    assert agreement(one, across, hair) < -0.95
    assert agreement(one, np.zeros_like(one), hair) == 0.0
    assert agreement(one, one, np.zeros_like(hair)) == 0.0
    assert 0.0 < agreement(one[:4, :4], one[:4, :4], hair[:4, :4]) < 0.5, "few strands tell little"
