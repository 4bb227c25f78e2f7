"""Synthetic people: what a portrait's truth says is what its pixels show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
pytest.importorskip("moderngl", reason="moderngl is not installed: pip install '.[train]'")

from models.hair.random_styles import sample_style
from models.people import shards, strands
from models.people.cosmetics import EARRINGS, MADE_UP, earrings, make_up
from models.people.draw import renderer
from models.people.expression import draw_expression
from models.people.make import HAIRY, Portrait, portrait
from models.people.person import draw_person, lid_openings, the_head
from models.people.skins import BEARDS, HEIGHT, WIDTH, Skin
from models.people.strands import carried
from service.errors import ModelFault
from service.face.reading import part_labels as labels
from service.geometry.chart import Chart
from service.hair.groom import make_groom
from service.hair.style import NAMED

pytestmark = pytest.mark.train

SEEDS = range(12)
SIZE = 128
Arrays = npt.NDArray[np.floating]


def plainly(patch: pytest.MonkeyPatch) -> None:
    """Portraits in one plain skin: drawing those of the light stage would take minutes."""
    grey = np.full((HEIGHT, WIDTH, 3), 170, np.uint8)
    layers, roughness = np.zeros((HEIGHT, WIDTH, 4), np.uint8), np.array([0.25, 0.5, 0.7])
    skin = Skin(grey, layers, np.full(3, 0.02), 0.0, roughness, 30.0, True)
    beards = np.zeros((HEIGHT, WIDTH, BEARDS), np.uint8), np.zeros((HEIGHT, WIDTH, 2), np.uint8)
    patch.setattr("models.people.make.load_skin", lambda number, folder: skin)
    patch.setattr("models.people.make.load_beards", lambda folder: beards)


@pytest.fixture(scope="module")
def portraits() -> list[Portrait]:
    """A dozen portraits, and one of them again."""
    try:
        renderer()
    except ModelFault as fault:
        pytest.skip(str(fault))
    with pytest.MonkeyPatch.context() as patch:
        plainly(patch)
        return [*(portrait(seed, SIZE) for seed in SEEDS), portrait(SEEDS[3], SIZE)]


@pytest.fixture(scope="module")
def chart() -> Chart:
    return Chart.build(the_head(), 3072, 2048)


def surface(p: Portrait, chart: Chart) -> tuple[Arrays, npt.NDArray[np.bool_]]:
    """(H, W, 3) points of the head at the chart coordinates of each pixel, and where there are any.

    The chart is looked up at its nearest texel, and from there to the pixel's own (u, v) along the triangle's plane.
    """
    head = the_head()
    there = np.isfinite(p.chart[..., 0])
    u, v = np.nan_to_num(p.chart[..., 0]), np.nan_to_num(p.chart[..., 1])
    column = np.clip((u * chart.width).astype(int), 0, chart.width - 1)
    row = np.clip(((1 - v) * chart.height).astype(int), 0, chart.height - 1)
    triangle = chart.triangle[row, column]
    there &= triangle >= 0
    a, b, c = (head.uv[head.triangle_uv[triangle][..., k]].astype(float) for k in range(3))
    q = np.stack([u, v], -1).astype(float)

    def cross(x: Arrays, y: Arrays) -> Arrays:
        return np.asarray(x[..., 0] * y[..., 1] - x[..., 1] * y[..., 0])

    area = cross(b - a, c - a)
    second, third = cross(q - a, c - a) / area, cross(b - a, q - a) / area
    corners = p.vertices[head.triangles[triangle]].astype(float)
    weights = np.stack([1 - second - third, second, third], -1)
    # A texel beside an edge of the chart may belong to a neighbour, where the plane says little.
    there &= (weights > -0.5).all(-1)
    return np.einsum("hwk,hwkc->hwc", weights, corners), there


def test_the_charts_point_projects_to_its_pixel(portraits: list[Portrait], chart: Chart) -> None:
    for p in portraits:
        points, there = surface(p, chart)
        at = p.camera.project(points[there])
        row, column = np.nonzero(there)
        off = np.hypot(at[:, 0] - column - 0.5, at[:, 1] - row - 0.5)
        assert there.sum() > 0.01 * SIZE * SIZE
        assert np.quantile(off, 0.999) < 0.5, p.seed
        assert there.sum() > 0.98 * np.isfinite(p.chart[..., 0]).sum()
        depth = p.camera.to_camera(points[there])[:, 2]
        np.testing.assert_allclose(np.quantile(np.abs(depth - p.depth[there]), 0.999), 0.0, atol=1e-3)


def test_normals_are_unit_and_face_the_camera(portraits: list[Portrait]) -> None:
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    for p in portraits:
        there = p.part != labels.BACKGROUND
        np.testing.assert_allclose(np.linalg.norm(p.normal[there], axis=1), 1.0, atol=1e-3)
        rays = np.stack(
            [x - p.camera.principal_point[0], y - p.camera.principal_point[1], np.full_like(x, p.camera.focal_px)], -1
        )
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        solid = there & (p.part != labels.OTHER)  # flat things before the picture face its plane
        assert ((p.normal * rays).sum(-1)[solid] < 1e-3).all()


def test_every_pixel_has_a_part_and_what_hides_the_face_has_no_chart(portraits: list[Portrait]) -> None:
    for p in portraits:
        assert p.part.max() < len(labels.PARTS)
        charted = np.isfinite(p.chart[..., 0])
        assert np.isin(p.part[charted], labels.CHARTED).all()
        for part in (labels.IRIS, labels.SCLERA, labels.LIP):
            assert charted[p.part == part].all()
        assert (np.isinf(p.depth) == (p.part == labels.BACKGROUND)).all()
        assert ((p.chart[charted] >= 0) & (p.chart[charted] <= 1)).all()
    seen = {int(part) for p in portraits for part in np.unique(p.part)}
    assert {labels.BACKGROUND, labels.SKIN, labels.IRIS, labels.SCLERA, labels.HAIR, labels.CLOTH} <= seen


def test_strands_run_from_root_to_tip_where_hair_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Long hair that hangs runs down the picture; where nothing covers a pixel there is no direction."""
    plainly(monkeypatch)
    only = {name: float(name == "long_wavy") for name in NAMED}
    monkeypatch.setattr(strands, "CHANCE", {False: only, True: only})
    strands._grown.cache_clear()
    down = []
    for seed in (strands.SHARED * k + j for k in range(3) for j in (0, 1)):
        p = portrait(seed, SIZE, framing="hair")
        assert not p.direction[p.hair == 0].any()
        length = np.linalg.norm(p.direction, axis=2)
        assert np.isin(np.round(length, 2), (0.0, 1.0)).all()
        assert (p.part[p.hair > HAIRY] == labels.HAIR).all()
        roll = np.radians(p.camera.yaw_pitch_roll_deg()[2])
        ways = p.direction[(p.hair > 0.9) & (length > 0.5)] @ np.array([-np.sin(roll), np.cos(roll)])
        if len(ways) > 100:
            down.append(float((ways > 0).mean()))
    assert len(down) > 2
    assert np.mean(down) > 0.85


def test_grooms_follow_the_head_that_they_are_carried_to() -> None:
    """Roots lie on the skin of the mean head, and within 3 mm of that of anybody's."""
    from scipy.spatial import cKDTree

    head = the_head()
    skin = np.unique(head.triangles[head.triangle_part == 0])
    groom = make_groom(sample_style(3), 3, 2000)
    for seed in range(4):
        person = draw_person(seed)
        moved = carried(groom.strands[:, 0], person)
        before = cKDTree(head.mean[skin]).query(groom.strands[:, 0])[0]
        after = cKDTree(person.neutral[skin]).query(moved)[0]
        assert np.median(np.abs(after - before)) < 0.003


def test_make_up_and_earrings_go_with_the_sex_and_hang_at_the_lobes() -> None:
    """Shares are those that are stated, within four standard deviations; an earring touches the ear and hangs below."""
    head, count = the_head(), 400
    for male in (False, True):
        painted = sum(make_up(seed, male)["lidPaint"] != make_up(seed, male)["lipPaint"] for seed in range(count))
        worn = [earrings(seed, male, head.mean) for seed in range(count)]
        for share, found in ((MADE_UP[male], painted), (EARRINGS[male], sum(map(bool, worn)))):
            assert abs(found / count - share) < 4 * np.sqrt(share * (1 - share) / count) + 0.05 * share
        for mesh in (one for several in worn for one in several):
            side = "left" if mesh.position[:, 0].mean() > 0 else "right"
            ear = head.mean[head.region(f"ear_{side}") > 0.5]
            apart = np.linalg.norm(mesh.position[:, None] - ear[None], axis=2).min()
            assert apart < 0.006 and mesh.position[:, 1].max() < ear[:, 1].mean()
            assert mesh.triangles.max() < len(mesh.position) and np.isfinite(mesh.normal).all()


def test_closed_eyes_show_no_iris() -> None:
    """Of many people; by geometry: the lids meet, or the eyeball stands behind them."""
    names = the_head().expression_names
    closed = [seed for seed in range(200) if draw_expression(seed, names)[1] == "closed"]
    assert len(closed) > 5
    for seed in closed:
        assert lid_openings(draw_person(seed).vertices).max() < 1.0


def test_expressions_are_possible_and_lids_open_by_state() -> None:
    names = the_head().expression_names
    openings: dict[str, list[float]] = {state: [] for state in shards.EYE_STATES}
    for seed in range(60):
        values, state = draw_expression(seed, names)
        assert ((values >= 0) & (values <= 1)).all()
        units = dict(zip(names, values, strict=True))
        assert units["mouthClose"] <= units["jawOpen"] + 1e-9
        openings[state].append(float(lid_openings(draw_person(seed).vertices).mean()))
    assert np.mean(openings["closed"]) < np.mean(openings["half"]) < np.mean(openings["open"])


def test_an_order_is_one_shard_and_orders_meet_all_seeds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, portraits: list[Portrait]
) -> None:
    whole = shards.orders(10, 200, SIZE)
    assert [order["seed"] for order in whole.values()] == [10, 64, 128, 192]
    assert sum(order["count"] for order in whole.values()) == 200
    made: list[int] = []

    def fake(seed: int, size: int, folder: Path | None, framing: str, meshes: tuple[str, ...]) -> Portrait:
        made.append(seed)
        return portraits[0]

    monkeypatch.setattr("models.people.shards.portrait", fake)
    shards.draw_order(whole[f"people-{SIZE}-00000010-54.npz"] | {"seed": 5, "count": 2}, tmp_path / "people.npz")
    assert made == [5, 6]
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize("kind", ["BEANIE", "HAT"])
def test_a_hat_hides_the_hair_under_it_and_is_none_itself(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Caps and black hats were read as hair: people wore too few of them, all alike."""
    plainly(monkeypatch)
    order = ["FEDORA", "BEANIE", "HAT", "HEADSCARF"]
    for name in order:
        monkeypatch.setattr(f"models.people.dress.{name}", float(order.index(name) >= order.index(kind)))
    shown, hats = [], set()
    for seed in SEEDS:
        made = portrait(seed, SIZE, framing="hair")
        hat = made.part == labels.HAT
        shown.append(hat.mean())
        if hat.sum() > 50:
            assert (made.hair[hat] > 0.5).mean() < 0.25, "hair lies over the hat"
            hats.add(tuple((made.image[hat].mean(0) // 32).astype(int)))
    assert np.median(shown) > 0.03 and max(shown) < 0.6
    assert len(hats) > 4, "they are of many colours"
