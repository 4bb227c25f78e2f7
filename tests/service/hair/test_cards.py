"""Hair cards: what any renderer relies on, on all named styles and on a few random ones."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from models.hair.random_styles import sample_style
from service.colour import bytes_to_linear
from service.geometry.mesh import face_normals
from service.hair.atlas import BODY, CAP_CELL, cell_corners
from service.hair.cards import CAP_M, CUTOFF, HAIRLINE, PARTS, Budget, body_of, hair_parts
from service.hair.colour import KNOTS, HairColour
from service.hair.groom import Groom, make_groom
from service.hair.scalp import mean_scalp
from service.hair.style import NAMED
from service.hair.worn_hair import WornHair, hair_in_albedo
from service.materials.material import OwnMap
from service.materials.part import MeshPart, check_parts

SMALL = Budget(12_000, 512)
MOST_WITHIN = 0.06
STYLES = [*NAMED.values(), *(sample_style(seed) for seed in (5, 11, 40))]


@pytest.fixture(scope="module", params=range(len(STYLES)), ids=lambda k: f"{k}-{STYLES[k].kind}")
def made(request: pytest.FixtureRequest) -> tuple[Groom, tuple[MeshPart, ...]]:
    groom = make_groom(STYLES[request.param], 3, 2500)
    return groom, hair_parts(groom, mean_scalp(), SMALL)


def atlas(parts: tuple[MeshPart, ...]) -> np.ndarray:
    picture = parts[0].material.colour_map
    assert isinstance(picture, OwnMap)
    return picture.pixels


def test_stays_within_its_budget_and_on_its_texture(made: tuple[Groom, tuple[MeshPart, ...]]) -> None:
    _, parts = made
    assert [part.name for part in parts] == list(PARTS)
    assert 0.2 * SMALL.triangles < sum(len(part.faces) for part in parts) <= SMALL.triangles
    for part in parts:
        assert part.uv.min() >= 0
        assert part.uv.max() <= 1
        assert part.normals is not None
        assert np.allclose(np.linalg.norm(part.normals, axis=1), 1, atol=1e-4)
    assert len({id(part.material.colour_map) for part in parts}) == 1


def test_faces_look_out_of_the_body_of_hair(made: tuple[Groom, tuple[MeshPart, ...]]) -> None:
    # A normal on the other side of a face than its front is turned round by path tracers, and the face gets black.
    groom, parts = made
    cards = parts[0]
    assert cards.normals is not None
    front = face_normals(cards.vertices, cards.faces)
    with_front = (front * cards.normals[cards.faces].mean(1)).sum(1) > 0
    out = -body_of(groom.strands, mean_scalp()).slope(cards.vertices[cards.faces].mean(1))
    assert with_front.all()
    assert ((front * out).sum(1) > 0).mean() > 0.7


def test_ribbons_lie_on_the_strands(made: tuple[Groom, tuple[MeshPart, ...]]) -> None:
    groom, parts = made
    low, high = groom.strands.min((0, 1)) - 0.03, groom.strands.max((0, 1)) + 0.03
    for part in parts:
        assert (part.vertices >= low).all()
        assert (part.vertices <= high).all()


def test_ribbons_do_not_dip_into_the_head(made: tuple[Groom, tuple[MeshPart, ...]]) -> None:
    """Long quads that left a round forehead flat went through it, and the shade of roots looked like bare skin."""
    groom, (cards, *_) = made
    middle = cards.vertices[cards.faces].mean(1)
    root = cKDTree(groom.strands[:, 0]).query(middle)[0]
    over = middle[(root > 0.004) & (root < 0.03)]  # few of shaved hair
    assert len(over) < 500 or (mean_scalp().outside(over) < CAP_M).mean() < MOST_WITHIN


def test_ribbons_of_curls_wind() -> None:
    """Would break where locks that turn elsewhere share a ribbon: their turns cancel out, and 28 degrees are left."""
    groom = make_groom(NAMED["curly"], 3, 2500)
    cards = hair_parts(groom, mean_scalp(), Budget(60_000, 512))[0]
    steps = np.diff(cards.vertices.reshape(-1, 2, 3).mean(1), axis=0)  # from row to row, and from ribbon to ribbon
    size = np.linalg.norm(steps, axis=1)
    within = (size[1:] < 0.03) & (size[:-1] < 0.03)
    cosine = (steps[1:] * steps[:-1]).sum(1)[within] / np.maximum(size[1:] * size[:-1], 1e-12)[within]
    assert np.median(np.degrees(np.arccos(np.clip(cosine, -1, 1)))) > 40


def test_ribbons_of_coils_are_as_many_as_of_straight_hair() -> None:
    """An afro whose ribbons wound had fewer of them, each a whole lock: it stood in spikes."""
    counts = []
    for curl in ("4b", "1"):
        groom = make_groom(dataclasses.replace(NAMED["afro"], curl=curl), 3, 2500)
        cards = hair_parts(groom, mean_scalp(), SMALL)[0]
        pairs = np.concatenate([cards.faces[:, [0, 1]], cards.faces[:, [1, 2]]])
        joined = coo_array((np.ones(len(pairs)), pairs.T), (len(cards.vertices),) * 2)
        counts.append(connected_components(joined, directed=False)[0])
    assert counts[0] > 0.8 * counts[1]


def test_alpha_holds_in_mip_levels(made: tuple[Groom, tuple[MeshPart, ...]]) -> None:
    alpha = atlas(made[1])[..., 3].astype(np.float32) / 255
    low, high = cell_corners(np.array([BODY]))
    small = cv2.resize(alpha, (len(alpha) // 8, len(alpha) // 8), interpolation=cv2.INTER_AREA)
    (u0, v0), (u1, v1) = low[0] * len(small), high[0] * len(small)
    middle = small[round(len(small) - v0 - 0.5 * (v1 - v0)), int(u0 + 0.5 * (u1 - u0))]
    assert middle > CUTOFF
    assert abs(float(small.mean() - alpha.mean())) < 1e-3


def test_hairs_of_the_hairline_begin_one_behind_the_other(made: tuple[Groom, tuple[MeshPart, ...]]) -> None:
    """Ribbons that began with all of their hairs in one line drew a row of dark scallops on the forehead."""
    alpha = atlas(made[1])[..., 3].astype(np.float32) / 255

    def shown(cells: np.ndarray, first: float, last: float) -> float:
        """Mean coverage of cells between two places along them."""
        low, high = (corner * len(alpha) for corner in cell_corners(cells))
        tall = high[:, 1] - low[:, 1]
        rows = np.rint(len(alpha) - np.stack([low[:, 1] + last * tall, low[:, 1] + first * tall], 1)).astype(int)
        columns = np.rint(np.stack([low[:, 0], high[:, 0]], 1)).astype(int)
        return float(np.mean([alpha[a:b, left:right].mean()
                              for (a, b), (left, right) in zip(rows, columns, strict=True)]))  # fmt: skip

    body = np.arange(BODY)
    used = np.array([shown(body[k : k + 1], 0.0, 1.0) > 0 for k in range(len(body))])
    front, rest = body[HAIRLINE:][used[HAIRLINE:]], body[:HAIRLINE][used[:HAIRLINE]]
    assert len(front) and len(rest)
    assert shown(rest, 0.08, 0.12) > 0.8 * shown(rest, 0.3, 0.4)
    length = float(np.median(np.linalg.norm(np.diff(made[0].strands, axis=1), axis=2).sum(1)))
    if length < 0.08:  # the part of a longer one over which its hairs begin is as much already
        assert shown(front, 0.0, 0.04) < 0.6 * shown(rest, 0.04, 0.08)


def test_the_cap_is_closed_where_hair_is_full(made: tuple[Groom, tuple[MeshPart, ...]]) -> None:
    alpha = atlas(made[1])[..., 3]
    low, high = cell_corners(np.array(CAP_CELL))
    columns = slice(int(low[0] * len(alpha)) + 1, int(high[0] * len(alpha)))
    assert alpha[round((1 - float(high[1])) * len(alpha)), columns].min() > 220
    assert alpha[round((1 - float(low[1])) * len(alpha)) - 1, columns].max() < 20


def test_hair_without_the_photos_light_keeps_its_parts_together() -> None:
    groom = make_groom(NAMED["bob"], 3, 1500)
    parts = hair_parts(groom, mean_scalp(), SMALL)
    worn = WornHair(groom, "bob", {}, np.ones(len(groom), np.float32), in_photo_light=True)
    other, unlit = hair_in_albedo(worn, parts, np.array([0.5, 0.6, 0.8], np.float32))
    check_parts(unlit, [])
    assert not other.in_photo_light
    seen = atlas(parts)[..., 3] > 200
    before, after = (bytes_to_linear(atlas(one)[..., :3])[seen].mean(0) for one in (parts, unlit))
    assert (after < before).all()


def test_a_red_lamp_on_the_face_does_not_turn_brown_hair_green() -> None:
    groom = make_groom(NAMED["bob"], 3, 400)
    worn = WornHair(groom, "bob", {}, np.ones(len(groom), np.float32), in_photo_light=True)
    other, _ = hair_in_albedo(worn, hair_parts(groom, mean_scalp(), SMALL), np.array([0.4, 2.0, 1.6], np.float32))
    assert other.groom is not None and not other.groom.colour.dyed
    red, green, blue = np.median(other.groom.colour.linear().reshape(-1, 3), 0)
    assert red >= green >= blue


def test_bright_strands_of_black_hair_lose_the_skys_blue_as_dark_ones_do() -> None:
    """One factor for all left navy locks: the picture has the colours of the strands, bright ones too."""
    groom = make_groom(NAMED["bob"], 3, 1500)
    pigment = np.linspace(3, 0.2, len(groom), dtype=np.float32)[:, None, None] * np.ones((1, KNOTS, 1), np.float32)
    mirrors = HairColour(pigment * np.array([1, 0], np.float32), np.array([0.4, 0.25, 0], np.float32))
    groom = dataclasses.replace(groom, colour=mirrors)
    worn = WornHair(groom, "bob", {}, np.ones(len(groom), np.float32), in_photo_light=True)
    other, unlit = hair_in_albedo(worn, hair_parts(groom, mean_scalp(), SMALL), np.array([1, 0.9, 0.6], np.float32))
    assert other.groom is not None and not other.groom.colour.dyed
    picture = bytes_to_linear(atlas(unlit)[atlas(unlit)[..., 3] > 200][:, :3])
    hues = []
    for colours in (picture, other.groom.colour.linear().reshape(-1, 3)):
        bright = colours.mean(1)
        low, high = np.percentile(bright, (75, 95))
        usual = np.median(colours[(bright >= low) & (bright <= high)], 0)
        hues.append(usual / usual.sum())
    assert np.abs(hues[0] - hues[1]).max() < 0.05


def test_a_head_without_strands_wears_nothing() -> None:
    bald = make_groom(NAMED["crop"], 3, 1)
    fields = (bald.strands[:0], bald.root_uv[:0], bald.lock[:0], bald.colour)
    none = Groom(bald.style, *fields)
    assert hair_parts(none, mean_scalp(), SMALL) == ()
