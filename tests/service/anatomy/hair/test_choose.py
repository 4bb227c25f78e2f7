"""Choosing and fitting a style: the style that made a silhouette is found again from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.anatomy.hair.find_hair import BALD, CROPPED_MM, UNSEEN, choose
from service.anatomy.hair.tailored import hair_thickness_mm
from service.anatomy.hair.wearables import CLEARANCE_M, Cut, Frame, Skull, agreement, fits, hair_on, read_items
from service.arrays import Float32
from service.head.files import load_head
from service.head.regions import vertex_mask
from service.render.view import turned_camera
from tests.toyhead import sphere_head

HEAD, ITEMS = load_head(), read_items()
NEUTRAL = HEAD.shape(np.array([0.8, -0.6, 0.4]))
SKULL = Skull.of(HEAD, NEUTRAL)
SIDE = 96


@pytest.fixture(scope="module")
def frame() -> Frame:
    camera = turned_camera(NEUTRAL, 12.0, SIDE, SIDE)
    return Frame.of(camera, lambda at: at, SIDE, HEAD, NEUTRAL, vertex_mask(HEAD, "scalp"))


def silhouette(frame: Frame, name: str, cut: Cut) -> tuple[Float32, Float32]:
    """Hair of a style and the skin that it leaves free."""
    shown, _ = frame.hair(ITEMS.items[name], hair_on(ITEMS.items[name], ITEMS, SKULL, cut))
    return shown, np.asarray(np.isfinite(frame.behind) * (1 - shown), np.float32)


@pytest.mark.parametrize("name", ["hair/bob02", "hair/long01", "hair/short02", "hair/braid01"])
def test_a_style_is_found_again_from_its_silhouette(frame: Frame, name: str) -> None:
    shown, skin = silhouette(frame, name, Cut())
    found = choose(ITEMS, SKULL, frame, shown, skin, np.ones_like(shown))
    assert (found.name, found.cut) == (name, Cut())
    assert found.agreement > 0.99 and not found.doubts


def test_volume_and_the_side_of_the_parting_are_found_too(frame: Frame) -> None:
    shown, skin = silhouette(frame, "hair/bob02", Cut(volume=1.5, mirrored=True))
    found = choose(ITEMS, SKULL, frame, shown, skin, np.ones_like(shown))
    assert found.name == "hair/bob02" and found.cut.mirrored and found.cut.volume == 1.5


def test_a_tail_that_is_out_of_sight_is_not_worn(frame: Frame) -> None:
    """From the front, hair that is tied back looks short: men came with a ponytail."""
    shown, skin = silhouette(frame, "hair/short01", Cut())
    found = choose(ITEMS, SKULL, frame, shown, skin, np.ones_like(shown), ["hair/ponytail01", "hair/short01"])
    assert found.name == "hair/short01"


def test_long_hair_is_not_cut_to_be_short_hair(frame: Frame) -> None:
    """Hair that ends at the ears came as long hair cut off there, which hangs like a bell."""
    shown, skin = silhouette(frame, "hair/short02", Cut(volume=1.5))
    found = choose(ITEMS, SKULL, frame, shown, skin, np.ones_like(shown), ["hair/long01", "hair/short02"])
    assert found.name == "hair/short02"


def test_hair_cropped_to_the_skull_is_no_mesh(frame: Frame) -> None:
    """A buzz cut came as curls: it covers the scalp, but stands nowhere off it."""
    scalp = (frame.scalp > 0.3).astype(np.float32)
    skin = np.asarray(np.isfinite(frame.behind) * (1 - scalp), np.float32)
    found = choose(ITEMS, SKULL, frame, scalp, skin, np.ones_like(scalp))
    assert found.name is None and found.share > BALD
    thick = hair_thickness_mm(frame, scalp, np.ones_like(scalp))
    assert thick is not None and thick < CROPPED_MM
    worn, _ = silhouette(frame, "hair/short02", Cut())
    assert (hair_thickness_mm(frame, worn, np.ones_like(worn)) or 0.0) > CROPPED_MM
    assert hair_thickness_mm(frame, scalp, np.zeros_like(scalp)) is None, "what is hidden does not tell"


def test_longer_hair_is_longer(frame: Frame) -> None:
    short, long = (silhouette(frame, "hair/bob02", Cut(length=x))[0] for x in (0.6, 1.5))
    assert (long * frame.below).sum() > 1.3 * (short * frame.below).sum() > 0


def test_a_head_without_hair_wears_none(frame: Frame) -> None:
    empty, skin = np.zeros((SIDE, SIDE), np.float32), np.isfinite(frame.behind).astype(np.float32)
    found = choose(ITEMS, SKULL, frame, empty, skin, np.ones_like(empty))
    assert found.name is None and found.share < BALD and not found.doubts


def test_under_a_hat_the_shortest_is_worn_and_the_doubt_is_said(frame: Frame) -> None:
    empty = np.zeros((SIDE, SIDE), np.float32)
    known = np.where(frame.scalp > 0.05, 0, 1).astype(np.float32)
    found = choose(ITEMS, SKULL, frame, empty, empty, known)
    assert found.name == UNSEEN and found.doubts == ("hair-unseen",)


def test_hair_at_the_sides_of_a_tight_picture_tells(frame: Frame) -> None:
    """Its top is cut off, so that little scalp is seen: long brown hair came as short and fair."""
    shown, skin = silhouette(frame, "hair/long01", Cut())
    low = np.arange(SIDE)[:, None] > np.flatnonzero((frame.scalp > 0.5).any(1)).mean()
    known = np.broadcast_to(low, shown.shape).astype(np.float32)
    assert (frame.scalp * known).sum() < 0.4 * frame.scalp.sum()
    found = choose(ITEMS, SKULL, frame, shown * known, skin * known, known)
    assert found.name == "hair/long01" and not found.doubts


def test_a_style_that_is_named_is_worn_whatever_is_seen(frame: Frame) -> None:
    empty, skin = np.zeros((SIDE, SIDE), np.float32), np.isfinite(frame.behind).astype(np.float32)
    found = choose(ITEMS, SKULL, frame, empty, skin, np.ones_like(empty), ["hair/afro01"])
    assert found.name == "hair/afro01" and found.doubts == ("hair-style-poor",)


@pytest.mark.parametrize("name", ITEMS.names("hair"))
def test_hair_keeps_off_the_skin(name: str) -> None:
    points = hair_on(ITEMS.items[name], ITEMS, SKULL)
    _, away, _ = SKULL.nearest(points)
    inside = (away < 0.5 * CLEARANCE_M) & (away > -0.02)
    assert inside.mean() < 0.02


def test_agreement_of_soft_masks() -> None:
    a = np.array([[1.0, 0.5], [0.0, 0.0]], np.float32)
    one = np.ones_like(a)
    assert agreement(a, a, one) == 1.0
    assert agreement(a, np.zeros_like(a), one) == 0.0
    assert agreement(np.zeros_like(a), np.zeros_like(a), one) == 0.0
    assert agreement(a, one, one) == pytest.approx(1.5 / 4)


def test_another_head_wears_nothing() -> None:
    assert fits(ITEMS, HEAD)
    assert not fits(ITEMS, sphere_head(16, 24))
    assert not fits(ITEMS, replace(HEAD, mean=HEAD.mean[::-1].copy()))
