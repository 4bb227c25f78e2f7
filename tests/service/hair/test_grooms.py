"""Grooms: strands begin on the scalp, stay out of the body, have the length asked for, and repeat."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from models.hair.draw import draw, facing
from models.hair.random_styles import sample_style
from service.geometry.mesh import unit
from service.hair.colour import (
    EUMELANIN,
    KNOTS,
    PHEOMELANIN,
    SURFACE,
    absorption_of,
    as_absorbed,
    reflected,
)
from service.hair.groom import make_groom
from service.hair.guides import NECK_M, Combing, grow_several, grown, seen_parting
from service.hair.scalp import mean_scalp
from service.hair.style import LENGTHS, NAMED, WAVES, Curl
from service.head.files import load_head

COUNT = 600
"""Strands of a groom in these tests."""


def lengths_mm(points: np.ndarray) -> np.ndarray:
    return np.asarray(1000 * np.linalg.norm(np.diff(points, axis=1), axis=2).sum(1))


@pytest.mark.parametrize("kind", NAMED)
def test_strands_begin_on_the_scalp_and_stay_out_of_the_body(kind: str) -> None:
    """Would break: a push along a gradient that vanishes inside the body, or none after curls were wound."""
    skin, groom = mean_scalp(), make_groom(NAMED[kind], 3, COUNT)
    assert len(groom.strands) > 0.5 * COUNT * NAMED[kind].density
    assert np.isfinite(groom.strands).all() and np.isfinite(groom.colour.linear()).all()
    assert groom.colour.linear().min() >= 0 and groom.colour.linear().max() <= 1
    assert groom.root_uv.min() >= 0 and groom.root_uv.max() <= 1
    assert np.abs(skin.outside(groom.strands[:, 0])).max() < 0.006
    deep = skin.outside(groom.strands[:, 2:]) < -0.003
    assert deep.mean() < 0.01


@pytest.mark.parametrize("seed", range(24))
def test_random_styles_are_sound_and_repeat(seed: int) -> None:
    style = sample_style(seed)
    assert style == sample_style(seed) != sample_style(seed + 1000)
    one, same = make_groom(style, seed, 200), make_groom(style, seed, 200)
    np.testing.assert_array_equal(one.strands, same.strands)
    np.testing.assert_array_equal(one.colour.melanin, same.colour.melanin)
    assert np.isfinite(one.strands).all()


def test_baldness_of_temples_and_crown_meets_and_leaves_a_horseshoe() -> None:
    """Would break: lost one by one they leave a bridge of hair from side to side over a bald head."""
    roots = mean_scalp().roots(4000, np.random.default_rng(1))

    def left(receding: float, crown: float) -> tuple[float, float]:
        style = dataclasses.replace(NAMED["crop"], receding=receding, crown=crown)
        kept = grown(roots, style, np.random.default_rng(2)).elevation
        return tuple((kept > low).sum() / (roots.elevation > low).sum() for low in (0.95, -9.0))

    assert left(1, 0)[0] > 0.5 and left(0, 1)[0] > 0.3
    top, whole = left(1, 1)
    assert top < 0.02 and whole > 0.3


@pytest.mark.parametrize(("gather", "most_m"), [("ponytail", 0.08), ("bun", 0.09)])
def test_hair_that_is_tied_leaves_the_tie_in_one_body(gather: str, most_m: float) -> None:
    groom = make_groom(NAMED[gather], 4, COUNT)
    behind = groom.strands[:, -1]
    spread = np.linalg.norm(behind - np.median(behind, 0), axis=1)
    assert np.quantile(spread, 0.8) < most_m
    assert (behind[:, 2] < -0.15).mean() > 0.95


def test_curls_have_their_radius_about_their_lock() -> None:
    """A helix about a straight guide: the closed form of its length, over the length of its middle line."""
    wave = WAVES["3a"]
    style = dataclasses.replace(NAMED["long_wavy"], curl="3a", frizz_mm=0.0, flyaways=0.0, clump=0.0)
    straight = dataclasses.replace(style, curl="1")
    curled, plain = (np.median(lengths_mm(make_groom(s, 1, COUNT).strands)) for s in (style, straight))
    turn = np.hypot(1, 2 * np.pi * wave.radius_mm / wave.pitch_mm)
    assert 1.05 < curled / plain < 1.3 * turn


def test_no_strands_are_no_groom_and_no_error() -> None:
    """Everything receded: would break at the median of no lengths."""
    none = make_groom(dataclasses.replace(NAMED["crop"], density=0.0), 1, 50)
    assert none.strands.shape[0] == 0 and none.colour.linear().shape[0] == 0
    picture = draw(none, load_head(), facing(0, 48))
    assert picture.hair.max() == 0 and np.isfinite(picture.colour).all()


@pytest.mark.parametrize(
    "wrong", [{"top_mm": -1}, {"lift": 1.5}, {"lock_mm": 0}, {"curl": "5z"}, {"sides_mm": float("nan")}]
)
def test_a_style_that_cannot_be_is_refused_with_its_value(wrong: dict[str, float]) -> None:
    name, value = next(iter(wrong.items()))
    with pytest.raises(ValueError, match=name):
        dataclasses.replace(NAMED["crop"], **wrong)  # type: ignore[arg-type]
    assert value != getattr(NAMED["crop"], name)


@pytest.mark.parametrize("style", ["long_wavy", "bob"])
@pytest.mark.parametrize("parting", ["left", "middle"])
def test_no_parting_runs_down_the_back(style: str, parting: str) -> None:
    """It split the hair at the back into two curtains, with the nape bare between them."""
    worn = dataclasses.replace(NAMED[style], parting=parting)  # type: ignore[arg-type]
    points = make_groom(worn, 5, 4000).strands.reshape(-1, 3)
    row = points[(np.abs(points[:, 1] + 0.06) < 0.02) & (points[:, 2] < -0.1)]
    count = np.histogram(row[:, 0], np.arange(-0.055, 0.056, 0.01))[0]
    assert count.min() > 0.25 * np.median(count), count
    face = (np.abs(points[:, 0]) < 0.03) & (points[:, 2] > 0) & (np.abs(points[:, 1] + 0.05) < 0.04)
    assert face.mean() < 1e-3, "nor is what grows behind blended across the face"


def test_hair_that_is_combed_back_hangs_down_the_nape() -> None:
    """It stood out from the back of the head, and fell in a loop behind the neck."""
    style = dataclasses.replace(NAMED["long_wavy"], combing="back", lift=0.57, stiffness=0.62, volume_mm=9.4)
    style, rng, skin = dataclasses.replace(style, back_mm=540.0, cut_y=-0.26), np.random.default_rng(1), mean_scalp()
    roots = grown(skin.even.chosen(np.arange(600)), style, rng)
    points = grow_several([(style, roots, rng)], skin)[0]
    low = points[(np.abs(roots.azimuth) > 2.4) & (np.abs(roots.position[:, 1] + 0.02) < 0.02)]
    assert len(low) > 20 and np.quantile((low[:, :1, 2] - low[..., 2]).max(1), 0.9) < 0.06


def test_hair_on_shoulders_is_no_longer_than_the_rest() -> None:
    """What met the shoulders ran out along them: it was cut at a height only, and they are higher."""
    worn = dataclasses.replace(NAMED["bob"], cut_y=(cut := -0.2), curl="1", frizz_mm=0.0, flyaways=0.0, layers=0.0)
    worn = worn.scaled(2.5, *LENGTHS)
    points = make_groom(worn, 5, 1500).strands
    below = np.linalg.norm(np.diff(points, axis=1), axis=2) * (points[:, 1:, 1] < NECK_M)
    assert np.quantile(below.sum(1), 0.98) < NECK_M - cut + 0.03


def test_melanin_is_found_again_from_its_colour() -> None:
    for eu, pheo in ((0.1, 0.1), (0.6, 0.2), (2.0, 0.1), (0.15, 0.8)):
        colour = reflected(eu * EUMELANIN + pheo * PHEOMELANIN)
        np.testing.assert_allclose(absorption_of(colour), eu * EUMELANIN + pheo * PHEOMELANIN, rtol=1e-3)
        found = as_absorbed(np.broadcast_to(colour, (4, KNOTS, 3)))
        if colour.min() > 1.2 * SURFACE:  # black is told apart by its brightness alone
            np.testing.assert_allclose(found.melanin[0, 0], (eu, pheo), atol=0.03)
        assert not found.dye.any()
    assert as_absorbed(np.broadcast_to(np.array([0.05, 0.3, 0.1], np.float32), (4, KNOTS, 3))).dyed, "green"
    levels = np.geomspace(0.3, 3, 20, dtype=np.float32)[:, None, None]
    copper = as_absorbed(np.repeat(levels * np.array([0.17, 0.045, 0.02], np.float32), KNOTS, 1), dyed_from=0.0)
    red, green, blue = np.moveaxis(copper.linear(), -1, 0)
    assert (red > 1.8 * green).all() and (green > blue).all(), "bright strands were pink: all were dyed alike"
    assert len(copper.chosen(np.arange(5)).linear()) == 5
    for level in (0.0, 1.0):
        assert np.isfinite(as_absorbed(np.full((4, KNOTS, 3), level, np.float32)).melanin).all()


def test_the_picture_tells_where_hair_is_and_which_way_it_runs() -> None:
    groom = make_groom(NAMED["bob"], 1, 3000)
    picture = draw(groom, load_head(), facing(180, 96))
    assert 0.1 < (picture.hair > 0.5).mean() < 0.6
    there = picture.hair > 0.9
    assert picture.direction[there][:, 1].mean() > 0.6, "a bob seen from behind hangs down"
    size = np.linalg.norm(picture.direction, axis=2)
    assert np.all((np.abs(size - 1) < 1e-3) | (size == 0)) and np.isfinite(picture.colour).all()


def test_roots_lie_evenly() -> None:
    """Random roots would leave spots of bare skin: there a disc of 5 mm holds a third less or more than usual."""
    from scipy.spatial import cKDTree

    skin = mean_scalp()
    roots = skin.roots(10_000, np.random.default_rng(5))
    inner = roots.position[roots.edge > 0.95]
    count = cKDTree(roots.position).query_ball_point(inner, 0.005, return_length=True)
    assert count.std() / count.mean() < 0.6 / np.sqrt(count.mean())  # of a Poisson process: 1 / sqrt(mean)


def test_a_scalp_on_which_nothing_grows_is_refused() -> None:
    """Else the search for roots would not end."""
    skin = mean_scalp()
    with pytest.raises(ValueError, match="grows nowhere"):
        dataclasses.replace(skin, grows=0 * skin.grows).roots(10, np.random.default_rng(0))


def test_waves_begin_below_the_roots_and_curls_at_them() -> None:
    """All of a wavy head was tangled, crown and all: its own weight draws long hair straight at the roots."""

    def turns(curl: Curl) -> tuple[float, float]:
        """How much strands turn in a metre, radians, in their first and in their last third."""
        style = dataclasses.replace(NAMED["long_wavy"], curl=curl, frizz_mm=0.0, flyaways=0.0)
        plain = dataclasses.replace(style, curl="1")
        found = []
        for one in (style, plain):
            steps = np.diff(make_groom(one, 3, COUNT).strands, axis=1)
            size = np.linalg.norm(steps, axis=2)
            cosine = (steps[:, 1:] * steps[:, :-1]).sum(2) / np.maximum(size[:, 1:] * size[:, :-1], 1e-12)
            angle = np.arccos(np.clip(cosine, -1, 1)) / np.maximum(size[:, 1:], 1e-6)
            third = angle.shape[1] // 3
            found.append((np.median(angle[:, :third]), np.median(angle[:, -third:])))
        return found[0][0] - found[1][0], found[0][1] - found[1][1]

    wavy: tuple[Curl, ...] = ("2a", "2b")
    for curl in wavy:
        root, tip = turns(curl)
        assert tip > 5 and root < 0.4 * tip
    root, tip = turns("3b")
    assert root > 0.6 * tip


def _parted_at(place: float, sure: float) -> Combing:
    """A photo whose hair above the forehead is combed to both sides from a line ``place`` metres to the left."""

    def wish(points: np.ndarray, outwards: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        aside = np.sign(points[:, :1] - place) * np.array([[1.0, 0, 0]], np.float32)
        along = aside - outwards * (aside * outwards).sum(1, keepdims=True)
        return np.asarray(unit(along), np.float32), np.where(points[:, 1] > 0.075, np.float32(sure), np.float32(0))

    return wish


def test_hair_falls_to_the_side_to_which_the_photo_combs_it() -> None:
    """Parted in the middle by its style and farther aside by the photo, it was combed to one side, turned back on the
    forehead and fell to the other: a tuft.
    """
    style, place = dataclasses.replace(NAMED["side_part"], combing="down", parting="middle"), -0.04
    style, roots, wish = style.scaled(2.0, "top_mm", "fringe_mm"), mean_scalp().even, _parted_at(place, 0.8)
    assert seen_parting(style, roots, wish) == pytest.approx(place, abs=0.006)
    assert seen_parting(style, roots, _parted_at(place, 0.02)) is None, "hardly sure"
    assert seen_parting(style, roots, _parted_at(0.0, 0.8)) is None, "the style says the same"
    points = make_groom(style, 3, 8000, wish=wish).strands
    strands, (x, y, z) = points[..., 0], points[:, 0].T
    between = (x > place + 0.008) & (x < -0.005) & (z > -0.02) & (y > 0.07)
    assert between.sum() > 50 and (strands[between, -1] > x[between]).mean() > 0.95
    assert np.quantile(strands[between].max(1) - strands[between, -1], 0.9) < 0.02, "none turns back"
