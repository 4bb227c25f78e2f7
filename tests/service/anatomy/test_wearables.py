"""Lashes, brows and the bust: their file, and how they follow a head."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from service.anatomy.canvas import brow_plane
from service.anatomy.items import read_items
from service.anatomy.wearables import bust_part, hides_brows, made_up_brows, seam, to_albedo
from service.arrays import Float32
from service.colour import linear_to_srgb
from service.errors import ModelFault
from service.geometry.chart import Chart
from service.geometry.mesh import area_normals
from service.head.files import load_head
from tests.service.archive.toys import toy_avatar

HEAD, ITEMS = load_head(), read_items()


@pytest.mark.parametrize("name", sorted(ITEMS.items))
def test_items_are_sound(name: str) -> None:
    item = ITEMS.items[name]
    assert item.triangles.min() >= 0 and item.triangles.max() == len(item.rest) - 1
    assert item.follow.min() >= 0 and item.follow.max() < len(HEAD.mean)
    np.testing.assert_allclose(item.share.sum(1), 1.0, atol=0.005)
    assert np.abs(item.rest).max() < 0.5


@pytest.mark.parametrize("name", ["lash/eyelashes02", "bust/body"])
def test_a_head_that_moves_takes_its_things_along(name: str) -> None:
    item, shift = ITEMS.items[name], np.array([0.01, -0.02, 0.03], np.float32)
    moved = item.worn(np.broadcast_to(shift, HEAD.mean.shape))
    np.testing.assert_allclose(moved, item.rest + shift, atol=2e-4)


def test_the_bust_is_the_heads_own_neck_where_they_meet() -> None:
    item = ITEMS.items["bust/body"]
    own, of = seam(item)
    assert len(own) >= 40
    neutral = HEAD.shape(np.array([1.5, -1.0, 0.5]))
    worn = item.worn(neutral - ITEMS.fitted_head)
    assert np.abs(worn[own] - neutral[of]).max() < 3e-5


def test_a_missing_or_torn_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelFault, match="missing"):
        read_items(tmp_path / "none.npz")
    (tmp_path / "torn.npz").write_bytes(b"PK\x03\x04 torn")
    with pytest.raises(ModelFault, match="cannot be read"):
        read_items(tmp_path / "torn.npz")


def test_the_bust_leaves_the_neck_in_its_tangent_planes() -> None:
    item = ITEMS.items["bust/body"]
    at, of = seam(item)
    neutral = HEAD.shape(np.array([1.5, -1.0, 0.5]))
    fit = replace(toy_avatar().fit, vertices=neutral, neutral=neutral)
    bust = bust_part(HEAD, fit, np.full((64, 96, 3), 128, np.uint8))
    assert bust is not None
    own = area_normals(fit.neutral, HEAD.triangles)[of]

    def turn(normals: Float32) -> float:
        return float(np.degrees(np.arccos(np.clip((own * normals).sum(1), -1, 1))).max())

    plain = item.worn(fit.neutral - ITEMS.fitted_head)
    assert turn(area_normals(plain, item.triangles)[at]) > 15, "without: a kink"
    assert turn(area_normals(bust.neutral, bust.faces)[at]) < 10
    assert bust.normals is not None and turn(bust.normals[at]) < 0.5, "a highlight would end at the seam"
    np.testing.assert_allclose(bust.neutral[at], fit.neutral[of], atol=2e-5)
    # Far from the seam the shoulders are the base mesh's, less its corners.
    far = np.flatnonzero(np.abs(plain[:, 0]) > 0.15)
    assert np.linalg.norm(bust.neutral[far] - plain[far], axis=1).max() < 0.008


def test_brows_are_made_up_where_both_are_hidden_and_only_there() -> None:
    """Behind shades the completed skin had a blurred stain for brows; who shows one brow has it mirrored."""
    chart = Chart.build(HEAD, 288, 192)
    seen = np.full((192, 288), 255, np.uint8)
    shades, one = seen.copy(), seen.copy()
    shades[brow_plane(chart) > 0] = 0
    one[:, :144][brow_plane(chart)[:, :144] > 0] = 0
    assert hides_brows(chart, shades) and not hides_brows(chart, one) and not hides_brows(chart, seen)
    hair = np.array([0.2, 0.1, 0.05], np.float32)
    brows = made_up_brows(hair)
    assert brows.shape in ITEMS.names("brow") and (brows.colour < hair).all()


def test_the_photos_light_is_the_ratio_on_lit_skin() -> None:
    rng = np.random.default_rng(2)
    albedo = rng.uniform(0.3, 0.6, (20, 20, 3)).astype(np.float32)
    light = np.array([0.8, 0.7, 0.5], np.float32)
    coded = [np.rint(255 * linear_to_srgb(x)).astype(np.uint8) for x in (albedo, albedo * light)]
    lit = np.full((20, 20), 255, np.uint8)
    coded[1][:5] = 3  # hair, which is not lit skin
    lit[:5] = 0
    np.testing.assert_allclose(to_albedo(coded[1], coded[0], lit), 1 / light, rtol=0.02)
    assert np.array_equal(to_albedo(coded[1], coded[0], np.zeros_like(lit)), np.ones(3))
