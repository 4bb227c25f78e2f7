"""A style takes over outline, hairline and length from a picture, and nothing where the picture is its own."""

from __future__ import annotations

import numpy as np
import pytest

from service.anatomy.hair.tailored import Tailored, tailored
from service.anatomy.hair.wearables import CLEARANCE_M, EAR_M, Frame, Item, Skull, agreement, hair_on, read_items
from service.arrays import Float32, Int32
from service.head.files import load_head
from service.head.regions import vertex_mask
from service.render.view import turned_camera

HEAD, ITEMS = load_head(), read_items()
NEUTRAL = HEAD.shape(np.array([0.8, -0.6, 0.4]))
SKULL = Skull.of(HEAD, NEUTRAL)
SIDE = 128


@pytest.fixture(scope="module")
def frame() -> Frame:
    camera = turned_camera(NEUTRAL, 0.0, SIDE, SIDE)
    return Frame.of(camera, lambda at: at, SIDE, HEAD, NEUTRAL, vertex_mask(HEAD, "scalp"))


def worn(name: str) -> tuple[Item, Float32]:
    return ITEMS.items[name], hair_on(ITEMS.items[name], ITEMS, SKULL)


def drawn(frame: Frame, item: Item, made: Tailored) -> Float32:
    """Silhouette of what was made."""
    whole = Item(item.name, made.points, item.follow[:1], item.share[:1], made.uv, made.triangles, item.picture)
    return frame.hair(whole, made.points)[0]


ONE = np.ones((SIDE, SIDE), np.float32)


def test_hair_that_agrees_stays_as_it_is(frame: Frame) -> None:
    item, points = worn("hair/short02")
    shown, _ = frame.hair(item, points)
    made = tailored(item, points, SKULL, frame, shown, ONE)
    assert made.ends_m is None and abs(made.wider_m) < 0.002
    assert agreement(shown, drawn(frame, item, made), ONE) > 0.9


def test_fuller_hair_becomes_fuller(frame: Frame) -> None:
    import cv2

    item, points = worn("hair/short01")
    shown, _ = frame.hair(item, points)
    wide = np.asarray(cv2.dilate(shown, np.ones((9, 9))), np.float32)
    fuller = np.where(np.isfinite(frame.behind), shown, wide)
    before = agreement(fuller, shown, ONE)
    made = tailored(item, points, SKULL, frame, fuller, ONE)
    assert made.wider_m > 0.004
    assert agreement(fuller, drawn(frame, item, made), ONE) > before + 0.1


def test_a_fringe_over_skin_is_cut(frame: Frame) -> None:
    item, points = worn("hair/bob01")
    whole, _ = frame.hair(item, points)
    y = np.mgrid[:SIDE, :SIDE][0]
    brows = frame.camera.project(np.array([[0.0, 0.05, 0.0]]))[0, 1]
    shown = np.asarray(whole * ~(np.isfinite(frame.behind) & (y > brows)), np.float32)
    made = tailored(item, points, SKULL, frame, shown, ONE)
    face = np.isfinite(frame.behind) & (y > brows + 4)
    left = drawn(frame, item, made)
    assert (whole * face).sum() > 200
    assert (left * face).sum() < 0.15 * (whole * face).sum(), "the face is free"
    assert (left * shown).sum() > 0.8 * shown.sum(), "the rest stays"


def test_long_hair_is_cut_where_the_photos_ends(frame: Frame) -> None:
    item, points = worn("hair/long01")
    whole, _ = frame.hair(item, points)
    y = np.mgrid[:SIDE, :SIDE][0]
    ends = -0.09
    shown = np.asarray(whole * (y < frame.camera.project(np.array([[0.0, ends, -0.05]]))[0, 1]), np.float32)
    made = tailored(item, points, SKULL, frame, shown, ONE)
    assert made.ends_m == pytest.approx(ends, abs=0.025)
    assert made.points[:, 1].min() > ends - 0.035 > points[:, 1].min()
    assert made.points[:, 1].max() > 0.9 * points[:, 1].max()


def test_what_is_unknown_changes_nothing(frame: Frame) -> None:
    item, points = worn("hair/long01")
    made = tailored(item, points, SKULL, frame, np.zeros_like(ONE), np.zeros_like(ONE))
    assert made.ends_m is None and made.wider_m == 0.0 and len(made.triangles) == len(item.triangles)


@pytest.mark.parametrize("name", ["hair/afro01", "hair/bob02", "hair/braid01", "hair/short04"])
def test_it_keeps_off_the_skin_and_is_valid(frame: Frame, name: str) -> None:
    item, points = worn(name)
    shown, _ = frame.hair(*worn("hair/short02"))
    made = tailored(item, points, SKULL, frame, shown, ONE)
    assert np.isfinite(made.points).all() and np.isfinite(made.uv).all()
    assert made.triangles.min() >= 0 and made.triangles.max() == len(made.points) - 1
    _, away, _ = SKULL.nearest(made.points[made.points[:, 1] > EAR_M])
    assert ((away < 0.25 * CLEARANCE_M) & (away > -0.02)).mean() < 0.03


def test_a_style_that_the_photo_lacks_altogether_is_left_whole(frame: Frame) -> None:
    item, points = worn("hair/short02")
    made = tailored(item, points, SKULL, frame, np.zeros_like(ONE), ONE)
    assert len(made.triangles) >= len(item.triangles)


def test_an_ear_that_is_seen_makes_no_hole_on_the_side_that_is_not() -> None:
    """The unseen side takes over the hairline, not the ear that hair is put behind."""
    camera = turned_camera(NEUTRAL, 40.0, SIDE, SIDE)
    turned = Frame.of(camera, lambda at: at, SIDE, HEAD, NEUTRAL, vertex_mask(HEAD, "scalp"))
    item, points = worn("hair/bob02")
    shown, _ = turned.hair(item, points)
    ears = [NEUTRAL[vertex_mask(HEAD, f"ear_{side}") > 0.5].mean(0) for side in ("left", "right")]
    seen, unseen = sorted(ears, key=lambda ear: camera.to_camera(ear[None])[0, 2])
    x, y = camera.project(seen[None])[0]
    rows, columns = np.mgrid[:SIDE, :SIDE]
    shown = np.where((columns - x) ** 2 + (rows - y) ** 2 < 12**2, 0, shown).astype(np.float32)
    made = tailored(item, points, SKULL, turned, shown, ONE)

    def over(ear: Float32, points: Float32, triangles: Int32) -> float:
        """Square metres of hair beside an ear."""
        corners = points[triangles]
        area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        centres = corners.mean(1)
        near = (np.linalg.norm((centres - ear)[:, 1:], axis=1) < 0.02) & (centres[:, 0] * ear[0] > 0)
        return float(area[near].sum())

    left = [over(ear, made.points, made.triangles) / over(ear, points, item.triangles) for ear in (seen, unseen)]
    assert left[0] < 0.6 and left[1] > 0.85, left
