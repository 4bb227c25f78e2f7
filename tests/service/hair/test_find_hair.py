"""From what a photo shows of hair to strands on the head: choice, fit, colour, and what callers ask for."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from service.colour import linear_to_srgb, luma
from service.errors import ModelFault, UsageError
from service.face.region import Region
from service.geometry.nearest import Nearest
from service.hair import find_hair as find_hair_module
from service.hair.asked import STYLES, AskedHair, checked_colour, checked_hair, parse_hair, parse_length
from service.hair.bank import Matches, kind_of, match, mirrored, read_bank
from service.hair.colour import COLOURS, KNOTS, SHINE, as_absorbed, asked_colour
from service.hair.find_hair import (
    COVERS_M,
    Tried,
    candidates,
    choose,
    grow_hair,
    only_skin,
    painted,
    see_hair,
    usual_curl,
    without_veil,
)
from service.hair.groom import make_groom
from service.hair.kinds import CURLS, LENGTHS
from service.hair.outline import to_outline
from service.hair.reading import CELLS
from service.hair.scalp import CENTRE, Scalp
from service.hair.shape import (
    BUST_M,
    FRINGED,
    filled,
    fitted,
    seen_share,
    seen_thinning,
    to_hairline,
    trimmed,
    upright,
)  # fmt: skip
from service.hair.sight import Sight, overlap
from service.hair.style import NAMED, Style, style_to_json
from service.hair.worn_hair import RETURNED, WornHair, hair_cards, hair_in_albedo, over_skin
from service.head.files import load_head
from service.head.model import HeadModel
from service.options import Options
from service.photo.photo import Photo
from service.render.sketch import MIRRORED, with_gloss
from tests.support.hair import fit_of, photographed

HEAD = load_head()
SKIN = Scalp.of(HEAD)
USUAL_SKIN = np.array([0.5, 0.3, 0.2], np.float32)


def find_hair(head: HeadModel, asked: AskedHair, strands: int) -> WornHair:
    """Of a grey photo in which nothing is read."""
    photo, fit = (
        picture_of(np.full(3, 0.2)),
        fit_of(HEAD.mean, photographed(NAMED["crop"], 1, HEAD, strands=50).fit.camera),
    )
    return grow_hair(see_hair(photo, head, fit, None, asked), photo, fit, asked, strands, 0)


@pytest.mark.parametrize("kind", ["crop", "bob", "long_wavy", "afro"])
def test_the_bank_knows_what_it_is_shown(kind: str) -> None:
    """A style of the bank grown from another seed; would break at a view taken for its mirror image."""
    seen = photographed(NAMED[kind], 77, HEAD, yaw=20.0)
    matches = match(read_bank(), seen.sight, seen.fit, HEAD, seen.reading)
    assert matches.probability.sum() == pytest.approx(1.0)
    assert next(iter(matches.kinds(read_bank()))) == kind
    assert matches.overlap.max() > 0.8


def test_the_colour_of_a_photos_black_is_not_the_hairs() -> None:
    """Blacks of faded film are blue: auburn hair was violet, and told as black. A photo with true blacks stays."""
    rng = np.random.default_rng(0)
    scene = rng.uniform(0, 0.5, (200, 200, 3)).astype(np.float32)
    scene[:20] = 0
    hair = np.array([0.18, 0.08, 0.04], np.float32)
    veil = np.array([0.0, 0.004, 0.02], np.float32)
    faded, true = (Photo(np.rint(255 * linear_to_srgb(scene + one)).astype(np.uint8)) for one in (veil, 0 * veil))
    np.testing.assert_allclose(without_veil(hair + veil, faded), hair, atol=2e-3)
    np.testing.assert_allclose(without_veil(hair, true), hair, atol=1e-6)
    assert (without_veil(np.zeros(3, np.float32), faded) >= 0).all(), "darker than black has no logarithm"
    assert (without_veil(veil, Photo(np.full((4, 4, 3), (0, 0, 255), np.uint8)))[1:] > 0).all(), "all of it is one blue"


def test_the_rim_of_a_bare_skull_is_no_hair() -> None:
    """The edge of a bald head before a wall was read as hair: it wore a dark crop. Clipped sides are darker."""
    seen = photographed(NAMED["crop"], 1, HEAD).sight
    rows, columns = np.nonzero(np.isfinite(seen.behind) & (seen.hair > 0.6))
    rim = np.zeros_like(seen.hair)
    rim[rows[:120], columns[:120]] = 1
    pixels = np.full((CELLS, CELLS, 3), 150, np.uint8)
    narrow = dataclasses.replace(seen, hair=rim)
    assert only_skin(Photo(pixels), narrow)
    assert not only_skin(Photo(pixels), seen), "so much is hair, whatever its colour"
    pixels[rim > 0] = 80
    assert not only_skin(Photo(pixels), narrow)
    assert not only_skin(Photo(pixels), dataclasses.replace(seen, hair=0 * rim)), "nothing was read"


def test_a_bank_that_is_torn_is_named(tmp_path: Path) -> None:
    (tmp_path / "bank.npz").write_bytes(b"PK\x03\x04 torn")
    with pytest.raises(ModelFault, match=r"bank\.npz"):
        read_bank(tmp_path / "bank.npz")


@pytest.mark.parametrize(("kind", "other"), [("crop", "side_part"), ("bob", "long_wavy"), ("afro", "curly")])
def test_strands_take_the_photos_outline(kind: str, other: str) -> None:
    """From a style that is another: overlap grows by much, no strand is in the head, and the rest is finite."""
    seen = photographed(NAMED[kind], 3, HEAD)
    before = overlap(seen.sight.hair, photographed(NAMED[other], 1, HEAD).sight.hair, seen.sight.known)
    groom, share = fitted(NAMED[other], seen.sight, SKIN, 0, 2000)
    after = overlap(seen.sight.hair, seen.sight.drawn(groom.strands).mask, seen.sight.known)
    assert after > max(0.72, before + 0.05)
    assert np.isfinite(groom.strands).all() and len(share) == len(groom) and 0 <= share.min() <= share.max() <= 1
    assert (SKIN.outside(groom.strands[:, 2:]) < -0.003).mean() < 0.02


def test_a_head_that_is_fitted_too_large_keeps_its_hair() -> None:
    """The photo's outline lies in the skull of a head that is 6 % larger; hair was dragged into it, and went."""
    seen = photographed(NAMED["crop"], 3, HEAD)
    large = np.asarray(HEAD.mean * np.float32(1.06), np.float32)
    skin, fit = Scalp.of(HEAD, large), fit_of(large, seen.fit.camera)
    outside = np.asarray(np.isfinite(Sight.of(seen.reading, fit, HEAD).behind) & (seen.reading.mask < 0.1), np.float32)
    above = outside * (np.arange(CELLS)[:, None] < 0.45 * CELLS)
    sight = Sight.of(dataclasses.replace(seen.reading, background=np.asarray(above, np.float32)), fit, HEAD)
    groom, _ = fitted(NAMED["crop"], sight, skin, 0, 2000)
    top = (groom.strands[:, 0, 1] > 0.1 * 1.06) & (skin.outside(groom.strands).max(1) > 0.002)
    assert top.mean() > 0.08, "the top of the head is bald"


def test_what_fills_a_gap_neither_stands_up_nor_comes_through_the_head() -> None:
    """A photo with hair 30 mm above a crop's and in the middle of the far cheek: no lock reaches there alone."""
    seen = photographed(NAMED["crop"], 3, HEAD, yaw=30.0)
    hair = seen.sight.hair.copy()
    top = int(np.argwhere(hair.max(1) > 0.7)[0, 0])
    hair[top - 7 : top - 4, CELLS // 2 - 2 : CELLS // 2 + 2] = 1
    made = filled(seen.groom, dataclasses.replace(seen.sight, hair=hair), SKIN, np.random.default_rng(0))
    assert made.strands[..., 1].max() < seen.groom.strands[..., 1].max() + 0.012


def test_a_lock_is_bent_neither_off_the_skull_nor_over_a_bald_one() -> None:
    """Hair 20 mm above a bob, and on top of a horseshoe: strands stood there as horns, or were combed over."""
    seen = photographed(NAMED["bob"], 3, HEAD)
    hair = seen.sight.hair.copy()
    top = int(np.argwhere(hair.max(1) > 0.7)[0, 0])
    hair[top - 5 : top + 8, CELLS // 2 - 8 : CELLS // 2 + 8] = 1
    made = filled(seen.groom, dataclasses.replace(seen.sight, hair=hair), SKIN, np.random.default_rng(0))
    assert made.strands[..., 1].max() < seen.groom.strands[..., 1].max() + 0.003
    horseshoe = dataclasses.replace(NAMED["side_part"], crown=1.0, receding=1.0, parting="none")
    bald = photographed(horseshoe, 3, HEAD)
    hair = bald.sight.hair.copy()
    low = int(np.argwhere(np.isfinite(bald.sight.behind))[0, 0])
    hair[low : low + 6, CELLS // 2 - 12 : CELLS // 2 + 12] = 1
    rimmed, rng = dataclasses.replace(bald.sight, hair=hair), np.random.default_rng(0)
    combed = to_hairline(bald.groom, rimmed, SKIN, rng)
    for _ in range(4):  # each goes on from what the one before has bent: a lock lay across the forehead
        combed = filled(combed, rimmed, SKIN, rng)
    assert combed.strands[..., 1].max() < bald.groom.strands[..., 1].max() + 0.01


def test_a_few_roots_that_stand_alone_are_not_added() -> None:
    """A speck that is read as hair on the temple, far from the hairline, became a black spot; a patch is hair."""
    groom = (seen := photographed(NAMED["crop"], 3, HEAD)).groom
    roots = SKIN.roots(len(groom), np.random.default_rng(0), least=FRINGED)
    (rows, columns), visible = seen.sight.visible(*seen.sight.project(roots.position))
    away = Nearest(groom.strands[:, 0]).one(roots.position)[0] * (visible & (seen.sight.facing(roots) > 0.3))
    row, column = rows[away.argmax()], columns[away.argmax()]
    for wide, some in ((0, False), (6, True)):
        hair = np.zeros_like(seen.sight.hair)
        hair[row - wide : row + wide + 1, column - wide : column + wide + 1] = 1
        sight = dataclasses.replace(seen.sight, hair=hair, known=np.ones_like(hair))
        assert (len(to_hairline(groom, sight, SKIN, np.random.default_rng(0))) > len(groom)) == some, wide


def test_long_hair_covers_the_whole_ear() -> None:
    """Tips of ears, thinner than the grid's cells, came through loose hair: 4 mm out of what strands kept clear of."""
    ears = HEAD.mean[np.maximum(HEAD.region("ear_left"), HEAD.region("ear_right")) > 0.5].astype(np.float32)
    assert SKIN.over_ears.outside(ears).max() < 0.002


def test_no_crown_is_bald_that_the_photo_does_not_show() -> None:
    bald = dataclasses.replace(NAMED["crop"], crown=1.0, receding=0.8)
    front, above = (photographed(NAMED["crop"], 3, HEAD, pitch=pitch) for pitch in (0.0, -60.0))
    assert seen_thinning(bald, front.sight, SKIN).crown == 0 and seen_thinning(bald, front.sight, SKIN).receding < 0.4
    assert seen_thinning(bald, above.sight, SKIN).crown == 1
    horseshoe = photographed(dataclasses.replace(NAMED["crop"], crown=1.0, receding=1.0), 3, HEAD)
    kept = seen_thinning(bald, horseshoe.sight, SKIN)
    assert kept.crown == 1 and kept.receding > 0.5, "all of the top is bare from the front"
    known = horseshoe.sight.known.copy()
    known[: int(np.flatnonzero(np.isfinite(horseshoe.sight.behind).any(1))[0]) + 5] = 0
    higher = dataclasses.replace(horseshoe.sight, known=known, hair=horseshoe.sight.hair * known)
    assert seen_thinning(bald, higher, SKIN).crown == 1, "a fitted skull that is too high counted as hair"
    hidden = dataclasses.replace(horseshoe.sight, known=np.zeros_like(known))
    assert seen_thinning(bald, hidden, SKIN).receding == 0, "what a hat hides has not receded"
    doubtful = dataclasses.replace(front.sight, known=0.4 * front.sight.known, hair=np.zeros_like(known))
    assert seen_thinning(bald, doubtful, SKIN).crown == 0, "a fringe that nobody could name left the crown bald"


def test_styles_that_are_tried_are_gathered_as_the_reading_says() -> None:
    """A reading that is sure of a tie gets tied styles alone, one that is not gets none; the likeliest come first."""
    seen = photographed(NAMED["bun"], 3, HEAD)
    bank = read_bank()
    for tied in (0.9, 0.1):
        kinds = {**seen.reading.kinds, "gathered": {"none": 0.95 - tied, "half": 0.05, "tied": tied, "plaits": 0.0}}
        reading = dataclasses.replace(seen.reading, kinds=kinds)
        rows = candidates(bank, match(bank, seen.sight, seen.fit, HEAD, reading), reading, 6)
        assert len(rows) >= 6 and len(set(rows.tolist())) == len(rows)
        assert all((bank.style(int(row)).gather in ("ponytail", "bun")) == (tied > 0.5) for row in rows)


def test_curls_are_those_of_one_class_that_reading_and_styles_both_have() -> None:
    """The median over all classes lay between curls and straight hair: ringlets came out as waves."""
    seen, bank = photographed(NAMED["long_wavy"], 3, HEAD), read_bank()
    classes = np.tile([int(style.curl[0]) for style in bank.styles], 2)

    def told(bank_has: list[float], read: list[float]) -> str:
        probability = np.array([0.0, *bank_has])[classes]
        matches = Matches(probability / probability.sum(), np.zeros(len(classes), np.float32))
        kinds = {**seen.reading.kinds, "curl": dict(zip(CURLS, read, strict=True))}
        return usual_curl(bank, matches, dataclasses.replace(seen.reading, kinds=kinds))

    assert told([0.1, 1.0, 0.6, 0.1], [0.01, 0.13, 0.62, 0.25])[0] == "3"
    assert told([1.0, 1.0, 0.0, 0.0], [0.2, 0.7, 0.1, 0.0])[0] == "2"
    assert told([0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0])[0] == "2", "no style like this has curls"
    assert told([1.0, 1.0, 0.0, 0.0], [0.9, 0.1, 0.0, 0.0]) == "1"


def test_a_forehead_under_a_hat_is_no_bald_top() -> None:
    """Under a brim the head is fitted too low: skin was seen where the top should be, and long hair ended there."""
    long = dataclasses.replace(NAMED["long_wavy"], crown=1.0, receding=1.0)
    seen = photographed(NAMED["long_wavy"], 3, HEAD)
    rows = np.arange(CELLS)[:, None] < np.flatnonzero(np.isfinite(seen.sight.behind).any(1))[0] + CELLS // 6
    bare = dataclasses.replace(
        seen.sight, hair=np.where(rows, 0, seen.sight.hair), known=np.ones_like(seen.sight.known)
    )
    worn, usual = fitted(long, bare, SKIN, 0, 3000)[0], make_groom(NAMED["long_wavy"], 0, 3000, SKIN)
    front = [((one.strands[:, 0] - CENTRE)[:, 1:] > [0.04, 0.0]).all(1).sum() for one in (worn, usual)]
    assert front[0] > 0.8 * front[1], front


def test_a_kind_is_chosen_and_no_single_style_by_luck(monkeypatch: pytest.MonkeyPatch) -> None:
    seen, bank = photographed(NAMED["crop"], 3, HEAD), read_bank()
    matches = match(bank, seen.sight, seen.fit, HEAD, seen.reading)
    likeliest, share = next(iter(matches.kinds(bank).items()))
    assert share > 0.4
    for luck, wins in ((0.01, True), (0.5, False)):

        def tried(styles: Sequence[Style], *_: object, luck: float = luck) -> list[Tried]:
            return [Tried(one, 0.5 if kind_of(one) == likeliest else 0.5 - luck) for one in styles]

        monkeypatch.setattr("service.hair.find_hair.tried", tried)
        chosen = choose(bank, matches, seen.sight, Scalp.of(HEAD, HEAD.mean), 0, seen.reading, 200)
        assert (kind_of(chosen) == likeliest) == wins, luck


def test_no_hair_hangs_where_the_photo_shows_background() -> None:
    """Long hair on a head whose photo shows a crop: nothing is left below the jaw, not even behind the neck."""
    seen = photographed(NAMED["crop"], 3, HEAD)
    groom, _ = fitted(NAMED["long_wavy"], seen.sight, SKIN, 0, 2000)
    lowest = groom.strands[..., 1].min(1)
    assert np.quantile(lowest, 0.02) > -0.12
    hangs = NAMED["long_wavy"].cut_y
    assert hangs is not None and hangs < -0.3


def test_strands_are_cut_where_the_photo_shows_none_and_only_there() -> None:
    seen = photographed(NAMED["bob"], 3, HEAD)
    bare = dataclasses.replace(seen.sight, hair=np.zeros_like(seen.sight.hair))
    unknown = dataclasses.replace(bare, known=np.zeros_like(bare.known))
    rng = np.random.default_rng(0)
    strands = seen.groom.strands[:400]
    _, kept = trimmed(strands, bare, SKIN, rng)
    assert kept.mean() < 0.6, "what is seen on bare skin goes"
    same, kept = trimmed(strands, unknown, SKIN, rng)
    assert kept.all()
    np.testing.assert_allclose(same[:, [0, -1]], strands[:, [0, -1]], atol=1e-4)
    none, kept = trimmed(strands[:0], bare, SKIN, rng)
    assert len(none) == len(kept) == 0 and len(seen_share(strands[:0], bare)) == 0


def picture_of(colour: np.ndarray, shade: np.ndarray | float = 1.0) -> Photo:
    """A photo of the size of a view, of one linear colour (3,) times a shade (112, 112)."""
    linear = np.clip(np.broadcast_to(np.asarray(shade)[..., None], (112, 112, 1)) * colour, 0, 1)
    return Photo(np.rint(255 * linear_to_srgb(linear.astype(np.float32))).astype(np.uint8), None, "ab" * 32)


def test_strands_are_cut_by_their_length_not_by_their_points() -> None:
    """Strands whose points lie closer at the root, as those that were moved: cut by points, they hung over the face."""
    sight = photographed(NAMED["bob"], 3, HEAD).sight
    eyes = int(sight.project(np.array([[0.0, 0.0, 0.2]]))[0][0, 1])
    hair = np.repeat((np.arange(CELLS) < eyes)[:, None], CELLS, 1).astype(np.float32)
    above = dataclasses.replace(sight, hair=hair, known=np.ones_like(hair), behind=np.full_like(hair, np.inf))
    share = np.linspace(0, 1, 32) ** 2
    line = np.array([0.0, 0.1, 0.2]) + share[:, None] * np.array([0.0, -0.2, 0.0])
    made, kept = trimmed(np.repeat(line[None], 40, 0).astype(np.float32), above, SKIN, np.random.default_rng(0))
    assert kept.all()
    np.testing.assert_allclose(made[:, -1, 1], 0.0, atol=0.012)


def test_long_hair_ends_with_the_bust_unless_the_photo_shows_more_of_it() -> None:
    """A portrait ends at the chin, and nobody knows how long the hair is: it hung in the air below the bust."""
    long = photographed(NAMED["long_wavy"], 3, HEAD)
    low = long.groom.strands[..., 1].min()
    assert low < BUST_M - 0.05
    rows, _ = np.indices((CELLS, CELLS))
    chin = int(long.sight.project(np.array([[0.0, -0.1, 0.1]]))[0][0, 1])
    known = np.where(rows < chin, long.sight.known, 0).astype(np.float32)
    portrait = dataclasses.replace(long.sight, known=known, hair=long.sight.hair * known)
    made, kept = trimmed(long.groom.strands, portrait, SKIN, np.random.default_rng(0))
    assert kept.mean() > 0.9 and made[kept][..., 1].min() > BUST_M - 0.04
    shown = dataclasses.replace(long.sight, known=np.ones_like(known), hair=np.ones_like(known))
    whole, _ = trimmed(long.groom.strands, shown, SKIN, np.random.default_rng(0))
    assert whole[..., 1].min() < BUST_M - 0.05


@pytest.mark.parametrize("name", ["brown", "blond", "red"])
def test_the_photos_colour_is_taken_without_its_light(name: str) -> None:
    seen = photographed(NAMED["bob"], 3, HEAD)
    pure = dataclasses.replace(COLOURS[name], spread=0.0, fade=0.0)
    wanted = asked_colour(name, 1, 0).chosen(np.zeros(1, np.int64))
    shining = dataclasses.replace(wanted, melanin=pure.amounts(1, np.random.default_rng(0)), shine=SHINE)
    colour = np.median(shining.linear()[0], 0)
    gradient = np.broadcast_to(np.linspace(0.6, 1.5, 112), (112, 112))
    share = np.ones(len(seen.groom), np.float32)
    found = painted(
        picture_of(colour, gradient), seen.reading, seen.sight, seen.groom.strands, share, USUAL_SKIN, 0
    )  # fmt: skip
    linear = found.linear()
    np.testing.assert_allclose(np.median(linear.reshape(-1, 3), 0), colour, rtol=0.35, atol=0.004)
    left = linear[seen.groom.strands[:, -1, 0] > 0.05].mean(), linear[seen.groom.strands[:, -1, 0] < -0.05].mean()
    assert max(left) / min(left) < 1.45, "two and a half times before"
    assert found.measured


@pytest.mark.parametrize(("shown", "red"), [((0.064, 0.018, 0.037), True), ((0.033, 0.012, 0.015), False)])
def test_auburn_in_a_cold_shade_is_no_black(shown: tuple[float, float, float], red: bool) -> None:
    """Nor is black hair auburn, of which a photo's noise tells the hue."""
    seen = photographed(NAMED["bob"], 3, HEAD)
    share = np.ones(len(seen.groom), np.float32)
    pixels = picture_of(np.array(shown, np.float32), np.ones((112, 112)))
    found = painted(pixels, seen.reading, seen.sight, seen.groom.strands, share, USUAL_SKIN, 0)
    worn = WornHair(dataclasses.replace(seen.groom, colour=found), "bob", {}, share, in_photo_light=True)
    made = hair_in_albedo(worn, (), np.ones(3, np.float32))[0].groom
    assert made is not None
    usual = np.median(made.colour.linear().reshape(-1, 3), 0)
    assert bool(usual[0] > 2.3 * usual[1] and luma(usual) > 0.008) is red, usual  # black has 0.004


def test_black_hair_with_a_green_sheen_is_not_brown() -> None:
    """What it mirrors was taken for the colour of melanin, the brighter the more it mirrors: it came out golden."""
    seen = photographed(NAMED["bob"], 3, HEAD)
    share = np.ones(len(seen.groom), np.float32)
    pixels = picture_of(np.array([0.02, 0.025, 0.023], np.float32))
    found = painted(pixels, seen.reading, seen.sight, seen.groom.strands, share, USUAL_SKIN, 0)
    usual = np.median(found.linear().reshape(-1, 3), 0)
    np.testing.assert_allclose(usual, [0.02, 0.025, 0.023], atol=0.002)  # not the nearest brown
    worn = WornHair(dataclasses.replace(seen.groom, colour=found), "bob", {}, share, in_photo_light=True)
    for light in ((1, 1, 1), (1.6, 1.35, 1.28)):
        made = hair_in_albedo(worn, (), np.array(light, np.float32))[0].groom
        assert made is not None and luma(np.median(made.colour.linear().reshape(-1, 3), 0)) < 0.009


def test_skin_that_shines_through_short_hair_is_not_its_colour() -> None:
    """Black hair of four millimetres came out in the brown of skin and hair together."""
    seen, skin = photographed(NAMED["bob"], 3, HEAD), np.array([0.4, 0.2, 0.12], np.float32)
    black = np.array([0.02, 0.014, 0.01], np.float32)
    share, found = np.ones(len(seen.groom), np.float32), []
    for length_m in (0.004, 0.06):
        down = np.linspace(0, length_m, 32)[:, None] * np.array([0, -1, 0])
        strands = (seen.groom.strands[:, :1] + down).astype(np.float32)
        shown = black + np.exp(-((length_m / COVERS_M) ** 2)) * (skin - black)
        colour = painted(picture_of(shown), seen.reading, seen.sight, strands, share, skin, 0)
        found.append(luma(np.median(colour.linear().reshape(-1, 3), 0)) / luma(black))
    assert 0.4 < found[0] < 2.5 and 0.7 < found[1] < 1.4, found


def test_shadow_that_is_crushed_to_black_is_no_black_hair() -> None:
    """More than half of the auburn hair lies in it."""
    seen = photographed(NAMED["bob"], 3, HEAD)
    auburn = np.array([0.12, 0.04, 0.012], np.float32)
    shade = np.broadcast_to(np.where(np.arange(112) % 5 < 3, 0.01, 1.0), (112, 112))
    share = np.ones(len(seen.groom), np.float32)
    found = painted(
        picture_of(auburn, shade), seen.reading, seen.sight, seen.groom.strands, share, USUAL_SKIN, 0
    )  # fmt: skip
    red, _, blue = np.median(found.linear().reshape(-1, 3), 0)
    assert red > 0.02 and red > 2 * blue
    lit = painted(picture_of(auburn), seen.reading, seen.sight, seen.groom.strands, share, USUAL_SKIN, 0)
    assert red < 0.8 * np.median(lit.linear()[..., 0]), "but most dark hair in hard light is crushed, and came out fair"


def test_hair_at_the_edge_of_the_photo_tells_its_colour() -> None:
    """Only its cut-off edge is in the photo: what lies beyond was counted as bare around it, and it was guessed."""
    seen = photographed(NAMED["bob"], 3, HEAD)
    grey, share = np.full(3, 0.2, np.float32), np.ones(len(seen.groom), np.float32)
    hair = np.argwhere(seen.reading.mask > 0.9)
    top = int(np.median(hair[:, 0]))
    region = dataclasses.replace(seen.reading.region, y=seen.reading.region.y - top)
    reading = dataclasses.replace(seen.reading, region=region)
    sight = dataclasses.replace(seen.sight, region=region)
    assert painted(picture_of(grey), reading, sight, seen.groom.strands, share, USUAL_SKIN, 0).measured


def test_hair_of_a_tilted_head_hangs_down_when_it_is_held_upright() -> None:
    """It hung straight down in the photo, and stood off the upright head to the side."""
    seen = photographed(NAMED["long_wavy"], 3, HEAD)
    tilt = np.radians(25.0)
    turn = np.array([[np.cos(tilt), -np.sin(tilt), 0], [np.sin(tilt), np.cos(tilt), 0], [0, 0, 1]])
    camera = dataclasses.replace(seen.sight.camera, rotation=seen.sight.camera.rotation @ turn)
    down = camera.rotation.T @ np.array([0.0, 1.0, 0.0])  # the photo's downwards in the head's frame
    aside = seen.groom.strands.copy()
    low = aside[..., 1] < -0.06
    aside[..., 0] += np.where(low, (-0.06 - aside[..., 1]) * down[0] / -down[1], 0).astype(np.float32)
    tilted = dataclasses.replace(seen.groom, strands=aside)
    drift = seen.groom.strands[:, -1, 0]
    hung = upright(tilted, dataclasses.replace(seen.sight, camera=camera), SKIN)
    long = low.sum(1) > 8
    before, after = (np.abs(one[long, -1, 0] - drift[long]).mean() for one in (aside, hung.strands))
    assert before > 0.03 and after < 0.5 * before
    np.testing.assert_allclose(hung.strands[:, 0], aside[:, 0], atol=1e-6)
    np.testing.assert_allclose(upright(tilted, seen.sight, SKIN).strands, aside, atol=1e-6)


def test_brown_hair_under_a_blue_sky_is_brown() -> None:
    """As blue as it is green in the photo, brown without its light: it was taken for dyed, and came out blue."""
    seen = photographed(NAMED["crop"], 3, HEAD, strands=50)
    colour = as_absorbed(np.broadcast_to(np.array([0.058, 0.045, 0.047], np.float32), (len(seen.groom), KNOTS, 3)))
    groom = dataclasses.replace(seen.groom, colour=colour)
    worn = WornHair(groom, "crop", {}, np.ones(len(groom), np.float32), in_photo_light=True)
    made = hair_in_albedo(worn, (), np.array([1.72, 1.7, 1.49], np.float32))[0].groom
    assert made is not None
    red, green, blue = np.median(made.colour.linear().reshape(-1, 3), 0)
    assert red > 1.3 * green > 1.5 * blue


def test_grey_hair_is_neither_striped_nor_blond() -> None:
    """Strands were white or brown, and the head striped; what both show together was called blond."""
    for strands in (500, 5000):
        grey = asked_colour("grey", strands, 0).linear().mean(1)
        usual = np.median(grey, 0)
        assert 1 - usual.min() / usual.max() < 0.35 and 0.25 < luma(usual) < 0.6
        assert np.log(luma(grey)).std() < 0.25
    seen = photographed(NAMED["crop"], 3, HEAD, strands=50)
    shown = np.array([0.267, 0.223, 0.165], np.float32)
    colour = as_absorbed(np.broadcast_to(shown, (len(seen.groom), KNOTS, 3)), dyed_from=0.0)
    groom = dataclasses.replace(seen.groom, colour=colour)
    worn = WornHair(groom, "crop", {}, np.ones(len(groom), np.float32), in_photo_light=True)
    made = hair_in_albedo(worn, (), np.ones(3, np.float32))[0].groom
    assert made is not None and not made.colour.dyed
    found = np.median(made.colour.linear().reshape(-1, 3), 0)
    assert found[2] / found[0] > 0.55, "blond of this brightness has a third of blue"


def test_hair_below_the_sky_is_brighter_than_skin_of_its_colour() -> None:
    """Most of it faces the sky: it came out too fair. No light that is told, and no hair, tell nothing of it."""
    seen = photographed(NAMED["crop"], 3, HEAD, strands=200)
    even, above = np.zeros((9, 3)), np.zeros((9, 3))
    even[0] = above[0] = np.sqrt(4 * np.pi)
    above[1] = -0.7 * np.sqrt(4 * np.pi / 3)  # the camera's y points down
    fits = [dataclasses.replace(seen.fit, light=light) for light in (even, above, -above, 1e3 * above, 0 * above)]
    plain, bright, dim, most, none = (over_skin(seen.groom, fit) for fit in fits)
    assert dim < plain < bright and np.isfinite([most, none]).all() and 0.3 < none < most < 3
    assert plain == pytest.approx(RETURNED)
    assert over_skin(seen.groom, dataclasses.replace(seen.fit, light=None)) == over_skin(None, fits[0]) == 1.0


def test_what_strands_mirror_is_not_in_their_albedo() -> None:
    """Black hair came out at twice to four times its colour, and shone once more: it was grey in any light."""
    seen = photographed(NAMED["crop"], 3, HEAD, strands=50)

    def unlit(colour: list[float], light: tuple[float, float, float] = (1, 1, 1)) -> np.ndarray:
        shown = np.broadcast_to(np.array(colour, np.float32), (len(seen.groom), KNOTS, 3))
        own = as_absorbed(shown, dyed_from=-np.inf)
        groom, share = dataclasses.replace(seen.groom, colour=own), np.ones(50, np.float32)
        worn = WornHair(groom, "crop", {}, share, in_photo_light=True)
        made = hair_in_albedo(worn, (), np.array(light, np.float32))[0].groom
        assert made is not None and np.isfinite(made.colour.linear()).all()
        return np.median(made.colour.linear().reshape(-1, 3), 0)

    assert luma(unlit([0.027, 0.027, 0.027])) < 0.012, "black hair that shines"
    brown = np.array([0.1, 0.053, 0.022], np.float32)
    kept = unlit(with_gloss(brown).tolist())
    assert abs(np.log(luma(kept) / luma(brown))) < 0.2, "brown hair, of which little is shine"
    assert luma(unlit([0.4, 0.33, 0.24])) > 0.25, "fair hair"
    grey = unlit([0.142, 0.124, 0.111])
    assert grey.min() > 0.65 * grey.max(), "grey hair, faintly warm: it came out light brown"
    dark = unlit([0.127, 0.112, 0.1])
    assert dark.min() > 0.6 * dark.max(), "short grey hair, without the skin between it: it came out tan"
    sky = unlit([0.154, 0.101, 0.082], (1.05, 1.33, 1.9))
    assert sky[0] >= sky[1] >= 0.99 * sky[2], "black hair in haze: it came out violet"
    assert luma(unlit([0.3, 0.28, 0.26])) > 0.25, "grey hair tells no highlight: it came out dark"
    lamp = unlit([0.51, 0.37, 0.2], (0.67, 1.02, 1.83))
    assert lamp[0] >= 0.9 * lamp[2], "blond hair beside a lamp, its light told by the face: it came out blue"
    copper = unlit([0.28, 0.112, 0.046])
    assert copper[0] > 2.4 * copper[1] > 2.4 * copper[2], "copper: as pheomelanin, and olive in the end, it had 1.9"
    golden = unlit([0.205, 0.119, 0.046], (1.066, 0.976, 1.044))
    assert golden[0] < 1.95 * golden[1], golden[0] / golden[1]
    faint = unlit([0.1, 0.076, 0.069])
    assert faint.min() < 0.4 * faint.max(), "brown hair that mirrors the sky"
    levels = np.geomspace(1e-5, 0.9, 50).astype(np.float32)
    shown = with_gloss(levels)
    np.testing.assert_allclose(np.square(shown) / (shown + MIRRORED), levels, rtol=1e-4)
    assert not with_gloss(np.zeros(3, np.float32)).any()


def test_black_hair_that_mirrors_the_sky_is_not_violet_and_blue_hair_stays_blue() -> None:
    def usual(colour: list[float]) -> np.ndarray:
        made = as_absorbed(np.broadcast_to(np.array(colour, np.float32), (4, KNOTS, 3)))
        assert np.isfinite(made.melanin).all() and made.melanin.min() >= 0 and made.dye.min() >= 0
        assert made.dyed is (colour[2] > 0.1)
        return np.asarray(made.linear()[0, 0])

    black = usual([0.014, 0.013, 0.018])
    assert black[0] >= black[1] >= black[2] and luma(black.astype(np.float32)) < 0.03
    blue = usual([0.02, 0.05, 0.3])
    assert blue[2] > 2 * blue[0]


@pytest.mark.parametrize("name", STYLES)
def test_a_style_that_is_asked_for_is_worn(name: str) -> None:
    found = find_hair(HEAD, AskedHair(name, "blond", 150.0), 200)
    assert found.kind == kind_of(NAMED[name]) and found.groom is not None and not found.doubts
    longest = 1000 * np.linalg.norm(np.diff(found.groom.strands, axis=1), axis=2).sum(1).max()
    assert 100 < longest < 900, "curls are several times as long as their middle line"
    assert luma(np.median(found.groom.colour.linear().reshape(-1, 3), 0)) > 0.1
    bald = find_hair(HEAD, AskedHair("none"), 200)
    assert bald.groom is None and bald.kind == "none"


def test_a_head_without_a_scalp_wears_nothing_and_says_so() -> None:
    """A head model of one's own need not tell where hair grows; its cards were asked for a region that it lacks."""
    names = tuple("unknown" if name == "scalp" else name for name in HEAD.region_names)
    bare = dataclasses.replace(HEAD, region_names=names)
    found = find_hair(bare, AskedHair(), 200)
    assert found.groom is None and found.doubts == ("hair-not-for-this-head",)
    assert hair_cards(found, None, "draft", 0) == ()


def test_what_cannot_be_asked_for_is_refused_with_its_value(tmp_path: Path) -> None:
    bob = style_to_json(NAMED["bob"])
    for wrong in ("mohican", {"kind": "x"}, {**bob, "melanin": 3}, {**bob, "lock_mm": "9"}, {**bob, "lift": 7},
                  {**bob, "curl": "5z"}, {**bob, "kind": "a b"}, {**bob, "colour": 1}):  # fmt: skip
        with pytest.raises(UsageError, match="hair"):
            checked_hair(wrong)
    for wrong_colour in ("greenish", "#12345", "#12345g"):
        with pytest.raises(UsageError, match=wrong_colour):
            checked_colour(wrong_colour)
    for wrong_length in ("long", "12 inches"):
        with pytest.raises(UsageError, match=wrong_length):
            parse_length(wrong_length)
    (tmp_path / "list.json").write_text("[1]")
    for file in ("list.json", "none.json"):
        with pytest.raises(UsageError, match=file):
            parse_hair(str(tmp_path / file))
    for length in (0.5, 2000.0, float("nan")):
        with pytest.raises(UsageError, match="hair_length"):
            Options(hair_length=length)
    (tmp_path / "bob.json").write_text(json.dumps(style_to_json(NAMED["bob"])))
    assert Options(hair=parse_hair(str(tmp_path / "bob.json")), hair_colour="#5A3B25").hair_colour == "#5a3b25"
    assert parse_length("auto") is None and parse_length("120 mm") == 120.0


def test_what_is_uncovered_gets_strands_and_no_more() -> None:
    """A fringe on the forehead that no root's own length reaches: strands are bent from the hairline over it."""
    seen = photographed(dataclasses.replace(NAMED["bob"], fringe_mm=60.0), 3, HEAD)
    short = photographed(NAMED["bob"], 3, HEAD).groom
    made = filled(short, seen.sight, SKIN, np.random.default_rng(0))
    before, after = (
        overlap(seen.sight.hair, seen.sight.drawn(one[kept]).mask, seen.sight.known)
        for one, kept in (trimmed(each.strands, seen.sight, SKIN, np.random.default_rng(0)) for each in (short, made))
    )
    assert len(made) > len(short) and after > before + 0.02
    assert (SKIN.outside(made.strands[len(short) :, 2:]) < -0.003).mean() < 0.02
    own = photographed(NAMED["bob"], 3, HEAD)
    assert len(filled(own.groom, own.sight, SKIN, np.random.default_rng(0))) < 1.2 * len(own.groom)


def test_short_hair_is_not_bent_to_what_it_cannot_reach() -> None:
    """A tail behind the neck that was not told as one became a tuft of short hair that floats beside it: 66 strands."""
    seen = photographed(NAMED["side_part"], 3, HEAD, yaw=-25.0)
    tail = np.array([0.05, -0.09, -0.09]) + 0.008 * np.random.default_rng(0).normal(size=(200, 3))
    column, row = seen.sight.project(tail.astype(np.float32))[0].astype(int).T
    hair, known = seen.sight.hair.copy(), seen.sight.known.copy()
    hair[row, column] = known[row, column] = 1
    shown = dataclasses.replace(seen.sight, hair=hair, known=known)
    added = filled(seen.groom, shown, SKIN, np.random.default_rng(0)).strands[len(seen.groom) :]
    assert not (np.linalg.norm(added - tail.mean(0), axis=-1) < 0.02).any()


def test_cells_are_those_of_the_camera_and_the_square() -> None:
    sight = photographed(NAMED["crop"], 1, HEAD, yaw=25.0, pitch=-10.0, strands=50).sight
    turned = dataclasses.replace(sight, region=Region(50.0, 60.0, 90.0, 0.3))
    points = HEAD.mean[::40]
    cells, depth = turned.project(points)
    np.testing.assert_allclose(cells, turned.region.to_crop(turned.camera.project(points), CELLS), atol=1e-3)
    np.testing.assert_allclose(depth, turned.camera.to_camera(points)[:, 2], atol=1e-5)


def test_a_parting_is_found_on_its_own_side() -> None:
    """Mirror images are half of the bank: a photo of one is that of the other, turned."""
    left = photographed(NAMED["side_part"], 5, HEAD, yaw=-20.0)
    matches = match(read_bank(), left.sight, left.fit, HEAD, left.reading)
    turned = dataclasses.replace(left.sight, hair=left.sight.hair[:, ::-1])
    other = photographed(NAMED["bob"], 5, HEAD, yaw=20.0)
    again = match(read_bank(), turned, other.fit, HEAD, left.reading)
    half = len(read_bank().styles)
    np.testing.assert_allclose(again.overlap, np.roll(matches.overlap, half), atol=0.06)
    assert mirrored(mirrored(NAMED["side_part"])) == NAMED["side_part"]


def test_hair_that_is_not_seen_is_guessed_and_says_so() -> None:
    found = find_hair(HEAD, AskedHair(), 300)
    assert found.groom is not None and set(found.doubts) == {"hair-unseen", "hair-colour-guessed"}
    same = find_hair(HEAD, AskedHair(), 300)
    assert same.groom is not None
    np.testing.assert_array_equal(found.groom.strands, same.groom.strands)


@pytest.mark.parametrize(("least", "called"), [(0.12, "bald"), (0.0, "")])
def test_a_skull_is_bald_where_the_little_that_is_seen_of_it_is(
    least: float, called: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bald man whose photo ends above the forehead wore the crop of whom a hat hides; a hat leaves even less."""
    seen = photographed(NAMED["crop"], 3, HEAD)
    bare = dataclasses.replace(seen.reading, mask=np.zeros_like(seen.reading.mask))
    for row in range(CELLS - 1, 0, -1):
        rows = np.arange(CELLS)[:, None] >= row
        read = dataclasses.replace(bare, known=bare.known * np.asarray(rows, np.float32))
        if find_hair_module._on_scalp(Sight.of(read, seen.fit, HEAD), SKIN)[1] > least:
            break
    monkeypatch.setattr(find_hair_module, "read_hair", lambda *_: read)
    found = see_hair(picture_of(np.full(3, 0.2)), HEAD, seen.fit, object(), AskedHair())  # type: ignore[arg-type]
    assert found.unseen and found.without == called


def test_hair_that_is_seen_to_hang_is_not_called_short() -> None:
    """The network takes a bob for a crop; background beside the neck would say nothing against it."""
    sure = dict.fromkeys(LENGTHS, 0.02) | {"short": 0.9}
    for kind, told in (("long_wavy", False), ("crop", True)):
        seen = photographed(NAMED[kind], 5, HEAD)
        doubted = dataclasses.replace(seen.reading, kinds={**seen.reading.kinds, "length": sure}, ends_m=(-0.03, 0.01))
        read = seen.sight.hanging(doubted)
        assert (read.kinds["length"]["short"] == max(read.kinds["length"].values())) is told
        assert (read.ends_m[0] == -0.03) is told
        assert sum(read.kinds["length"].values()) == pytest.approx(1.0)


def test_an_ear_ring_is_no_lock() -> None:
    """A patch of few cells apart from all other hair; strands were bent to it from afar, and hung there as a ball."""
    seen = photographed(NAMED["crop"], 3, HEAD)
    mask, sides = seen.reading.mask.copy(), np.argwhere(np.isfinite(seen.sight.behind))
    row, column = sides[np.argmin(np.abs(sides - [70, 60]).sum(1))]
    mask[row - 1 : row + 2, column - 1 : column + 2] = 1
    for size, kept in ((2, False), (5, True)):
        mask[row - 1 : row - 1 + size, column - 1 : column - 1 + size] = 1
        sight = Sight.of(dataclasses.replace(seen.reading, mask=mask), seen.fit, HEAD)
        assert bool(sight.hair[row, column] > 0.5) == kept
        assert bool(sight.known[row, column] > 0.5) == kept


def test_no_strand_from_behind_an_ear_is_bent_over_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the fit has the ear lower than the photo, hair behind it is seen on the ear: it got a ball of hair."""
    seen = photographed(NAMED["bun"], 3, HEAD, yaw=-25.0)
    ear = SKIN.ears[SKIN.ears[:, 0] > 0]
    at, depth = seen.sight.project(ear)
    cells, before = seen.sight.visible(at, depth)
    low = (ear[:, 1] < np.median(ear[:, 1])) & before & (depth < seen.sight.behind[cells] + 0.002)
    hair = seen.sight.hair.copy()
    for column, row in at[low].astype(int):
        hair[row - 1 : row + 2, column - 1 : column + 2] = 1
    shown = dataclasses.replace(seen.sight, hair=hair)

    def over_the_ear() -> int:
        added = filled(seen.groom, shown, SKIN, np.random.default_rng(0)).strands[len(seen.groom) :, -4:]
        apart = np.linalg.norm(added[:, :, None] - ear[low][None, None], axis=-1)
        return int((apart < 0.006).any((1, 2)).sum())

    assert low.sum() > 3 and over_the_ear() < 5
    monkeypatch.setattr("service.hair.shape.FORWARDS_M", 1.0)
    assert over_the_ear() > 30, "what is bent forwards from behind it lies on it"


def test_no_tuft_of_longer_hair_lies_over_the_hairline() -> None:
    """The photo's hairline is lower than the groom's: long strands, cut off where they reached it, made dark tufts."""
    seen = photographed(NAMED["slicked_back"], 3, HEAD, yaw=20.0)
    hair = np.maximum(seen.sight.hair, np.roll(seen.sight.hair, 3, 0))
    groom = filled(seen.groom, dataclasses.replace(seen.sight, hair=hair), SKIN, np.random.default_rng(0))
    length = np.linalg.norm(np.diff(groom.strands, axis=1), axis=2).sum(1)
    assert len(groom) > len(seen.groom) and np.median(length[: len(seen.groom)]) > 0.03
    assert (length[len(seen.groom) :] < 0.02).sum() < 5, "110 of 235 were"


def test_hair_that_the_photo_cuts_off_above_goes_on_as_its_sides() -> None:
    """The sides came in to the photo's outline, the top stayed as its style had it: long hair was a cone."""
    seen = photographed(NAMED["bob"], 3, HEAD)
    top = int(np.argwhere(seen.sight.hair > 0.5)[:, 0].min())
    known = seen.sight.known.copy()
    known[: top + 12] = 0
    cut = dataclasses.replace(seen.sight, known=known, hair=seen.sight.hair * known)
    wide = CENTRE + (seen.groom.strands - CENTRE) * np.float32(1.15)
    before, after = (np.quantile(one[..., 1], 0.999) for one in (wide, to_outline(wide, cut, SKIN)))
    usual = np.quantile(seen.groom.strands[..., 1], 0.999)
    assert before - usual > 0.01 and before - after > 0.4 * (before - usual)
