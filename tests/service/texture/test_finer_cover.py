"""Strands and rims that are finer than the cells of the reader."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.arrays import Float32
from service.face.reading.part_labels import BEARD, BROW, GLASSES, HAIR, PARTS, SKIN
from service.geometry.chart import Chart
from service.head.files import load_head
from service.texture.finer_cover import finer_cover, in_the_dark, of_all
from service.texture.unwrap import Unwrapped, Zones

HEAD = load_head()
CHART = Chart.build(HEAD, 576, 384)
ZONES = Zones.of(CHART)
COUNT = len(CHART.texels)
ROW, COLUMN = np.divmod(CHART.texels, CHART.width)
TONE, HAIR_TONE = np.array([0.8, 0.62, 0.54], np.float32), np.array([0.75, 0.6, 0.35], np.float32)
LOCK = (np.abs(COLUMN - 210) < 4) & (ROW > 80) & (ROW < 165)
"""Texels of a lock that hangs down from the temple over the cheek."""
READ = ROW < 110
"""Where hair was read."""


def seen(colour: Float32) -> Unwrapped:
    """All is seen squarely."""
    noise = np.random.default_rng(0).normal(0, 0.01, colour.shape).astype(np.float32)
    shown = np.ones(COUNT, np.float32)
    return Unwrapped(colour + noise, shown, shown > 0, np.zeros((COUNT, 3), np.float32))


def parts(**shares: Float32) -> Float32:
    """Skin but for what is named."""
    found = np.zeros((COUNT, len(PARTS)), np.float32)
    for number, share in shares.items():
        found[:, int(number[1:])] = share
    found[:, SKIN] = 1 - found.sum(1)
    return found


@pytest.mark.parametrize("sure", [0.95, 0.5])
def test_a_lock_is_followed_beyond_what_was_read(sure: float) -> None:
    """Also under a hat, where the reader doubts it: a brown stain stayed at the temple, a dark line on the forehead."""
    hairy = (ROW < 60) | (LOCK & READ)
    colour = np.where((hairy | LOCK)[:, None], HAIR_TONE, TONE).astype(np.float32)
    cover, _ = finer_cover(CHART, seen(colour), parts(**{f"p{HAIR}": sure * hairy}), ZONES)
    own = ZONES.skin & (ZONES.hidden < 0.1)
    assert cover[LOCK & own & (ROW > 112) & (ROW < 160)].mean() > 0.8
    cheek = own & (np.abs(COLUMN - 230) < 8) & (ROW > 120) & (ROW < 160)
    assert cover[cheek].mean() < 0.02


def test_a_wide_lock_that_was_read_as_skin_is_no_skin() -> None:
    """Its own colour was among those of the skin beside it: it stayed as a brown stain, on the other cheek as well."""
    lock = (np.abs(COLUMN - 205) < 16) & (ROW > 80) & (ROW < 200)
    hairy = (ROW < 60) | (lock & READ)
    shade = 1 - 0.35 * np.clip((COLUMN - 280) / 80, 0, 1)[:, None]  # the other side is in the dark
    colour = np.where((hairy | lock)[:, None], HAIR_TONE * 0.6, TONE * shade).astype(np.float32)
    cover, _ = finer_cover(CHART, seen(colour), parts(**{f"p{HAIR}": 0.95 * hairy}), ZONES)
    own = ZONES.skin & (ZONES.hidden < 0.1)
    assert cover[lock & own & (ROW > 112) & (ROW < 190)].mean() > 0.9
    assert cover[own & (COLUMN > 235) & (ROW > 120) & (ROW < 190)].mean() < 0.01


def test_a_wisp_hangs_from_the_hair_and_a_wrinkle_does_not() -> None:
    """A strand of one texel before the forehead is of a colour between both: it stayed on the skin as a dark line."""
    hairy = ROW < 70
    wisp = (COLUMN == 270) & (ROW >= 70) & (ROW < 110)
    level = (ROW == 84) & (np.abs(COLUMN - 306) < 20)
    steep = (COLUMN == 306) & (ROW > 84) & (ROW < 104)
    colour = np.where(hairy[:, None], HAIR_TONE * 0.3, TONE)
    colour = np.where((wisp | level | steep)[:, None], 0.8 * TONE, colour).astype(np.float32)
    cover, _ = finer_cover(CHART, seen(colour), parts(**{f"p{HAIR}": 0.95 * hairy}), ZONES)
    assert cover[wisp & (ROW > 74)].mean() > 0.9
    assert cover[level | steep].max() == 0  # lines of the skin, though one of them is steep: it begins in no hair
    assert cover[(ROW > 76) & (np.abs(COLUMN - 285) < 8)].max() == 0
    wrinkled = (COLUMN % 12 == 0) & (ROW > 120)  # as deep all over the face: then lines beside hair are no strands
    lined = np.where(wrinkled[:, None], 0.7 * TONE, colour).astype(np.float32)
    assert (
        finer_cover(CHART, seen(lined), parts(**{f"p{HAIR}": 0.95 * hairy}), ZONES)[0][wisp & (ROW > 74)].mean() < 0.1
    )


def test_a_beard_of_the_hairs_colour_is_followed_by_none() -> None:
    """Hair beside it led into it: moustache and cheeks came out shaved."""
    beard = (ROW > 110) & (ROW < 200) & (np.abs(COLUMN - 205) < 30)
    hairy = (ROW < 60) | ((np.abs(COLUMN - 205) < 16) & (ROW > 80) & READ)
    colour = np.where((hairy | beard)[:, None], HAIR_TONE * 0.6, TONE).astype(np.float32)
    own = ZONES.skin & (ZONES.hidden < 0.1) & beard & (ROW > 116)
    for share, most in ((0.5, 0.01), (0.0, 1.0)):
        read = parts(**{f"p{HAIR}": 0.95 * hairy, f"p{BEARD}": share * (beard & ~hairy)})
        cover = finer_cover(CHART, seen(colour), read, ZONES)[0][own].mean()
        assert cover <= most
    assert cover > 0.5, "what was not read as beard is a lock"


def test_colours_of_which_none_are_alike_tell_nothing() -> None:
    """Each is far off in another channel: of those that are left there is no covariance, and hair was not a number."""
    third = np.arange(90) % 3
    values = np.zeros((10, 9, 3), np.float32)
    values.reshape(-1, 3)[np.arange(90), third] = 9.0
    for chosen in (np.ones((10, 9), np.float32), np.zeros((10, 9), np.float32)):
        assert not of_all(values, chosen).any()
    flat = np.full((10, 9, 3), 0.3, np.float32)
    assert np.isfinite(of_all(flat, np.ones((10, 9), np.float32))).all(), "nor is one colour alone singular"


def test_rims_are_found_where_glasses_are_worn() -> None:
    rim = (np.abs(ROW - 172) < 2) & (np.abs(COLUMN - 288) < 80)
    around = (np.abs(ROW - 165) < 25) & (np.abs(COLUMN - 288) < 90)
    colour = np.where(rim[:, None], 0.4 * TONE, TONE).astype(np.float32)
    _, worn = finer_cover(CHART, seen(colour), parts(**{f"p{GLASSES}": 0.15 * around}), ZONES)
    own = ZONES.skin & (ZONES.hidden < 0.1)
    assert worn[rim & own].mean() > 0.9
    assert worn[own & ~rim & (np.abs(ROW - 172) > 6)].mean() < 0.01
    assert max(one.max() for one in finer_cover(CHART, seen(colour), parts(), ZONES)) == 0  # a line on the skin
    brow = parts(**{f"p{GLASSES}": 0.15 * around, f"p{BROW}": 0.6 * rim})
    assert finer_cover(CHART, seen(colour), brow, ZONES)[1][rim].max() == 0


def test_what_is_nearly_black_hides_skin_and_brows_may_be_black() -> None:
    """Under a brim a cap's shadow came out as a black halo with black bars of brows; clipped channels were patches."""
    brim, brow, lit_brow = ROW < 120, np.abs(ROW - 110) < 4, np.abs(ROW - 150) < 4
    shaded = np.where((brim | lit_brow)[:, None], TONE * np.float32(0.03), TONE).astype(np.float32)
    read = parts(**{f"p{BROW}": (brow | lit_brow).astype(np.float32)})
    hidden, black = in_the_dark(CHART, seen(shaded), read, ZONES)
    own = ZONES.skin & (ZONES.hidden < 0.1) & (np.abs(ROW - 120) > 8) & (ZONES.face > 0.5)
    assert hidden[own & brim & ~brow].mean() > 0.9
    assert hidden[own & brow & (ROW < 110)].mean() > 0.9
    assert hidden[own & ~brim].max() < 0.1
    assert black[own & brim].mean() > 0.9 and black[own & ~brim].max() < 0.1
    assert in_the_dark(CHART, seen(TONE * np.full((COUNT, 1), 0.1, np.float32)), parts(), ZONES)[0][own].mean() < 0.3
    for colour in ((0, 0, 0), (0.5, 0.3, 0)):
        flat = replace(seen(shaded), colour=np.full((COUNT, 3), colour, np.float32))
        found = in_the_dark(CHART, flat, parts(), ZONES)
        assert np.isfinite(found).all(), "a face without light, or without any in one colour: its medians divide"


def test_what_has_no_light_left_is_told_from_what_a_colour_lacks() -> None:
    """Coloured light is the photo's and stays in the texture; black skin is noise. Black hair is hair, not shade."""
    half, own = ROW < 120, ZONES.skin & (ZONES.hidden < 0.1) & (np.abs(ROW - 120) > 8) & (ZONES.face > 0.5)
    for shade, gone in (((0.1, 0.1, 0.1), True), ((0.6, 0.1, 0.01), False), ((0.4, 0.4, 0.4), False)):
        photo = seen(np.where(half[:, None], TONE * np.array(shade), TONE).astype(np.float32))
        black = in_the_dark(CHART, photo, parts(), ZONES)[1]
        assert (black[own & half].mean() > 0.9) if gone else (black.max() < 0.05)
        hair = in_the_dark(CHART, photo, parts(**{f"p{HAIR}": half.astype(np.float32)}), ZONES)[1]
        assert hair[own].max() < 0.05
