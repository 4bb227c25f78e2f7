"""What training hides of the skin, as photos do."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")

from torch import Tensor  # noqa: E402

from models.networks.context import HEIGHT, WIDTH  # noqa: E402
from models.training.cover import BARE, LEAST, UNREAD, Cover  # noqa: E402
from service.geometry.chart import Chart  # noqa: E402
from service.head.files import load_head  # noqa: E402
from service.head.regions import vertex_mask  # noqa: E402
from service.reflectance.subject import Subject  # noqa: E402

pytestmark = pytest.mark.train

COVER = Cover()
HEAD = load_head(None)
CHART = Chart.build(HEAD, WIDTH, HEIGHT)


def geometry(count: int) -> Tensor:
    """Channels of the mean head."""
    channels = Subject(HEAD, HEAD.mean, CHART).geometry
    return torch.from_numpy(channels)[None].expand(count, -1, -1, -1)


@pytest.fixture(scope="module")
def lit() -> Tensor:
    """(300, h, w) of the mean head."""
    return COVER(geometry(300), torch.Generator().manual_seed(1))[:, 0]


def test_cover_is_a_share_and_leaves_enough(lit: Tensor) -> None:
    assert torch.isfinite(lit).all() and lit.min() >= 0.0 and lit.max() <= 1.0
    assert lit.mean((1, 2)).min() >= LEAST
    again = COVER(geometry(300), torch.Generator().manual_seed(1))[:, 0]
    assert torch.equal(lit, again)


def test_eyes_and_all_outside_are_never_lit_skin(lit: Tensor) -> None:
    """The service's plane of lit skin is 0 there; a network would else see them in training alone."""
    skin = torch.from_numpy(CHART.part == HEAD.part_names.index("skin"))
    assert not lit[:, ~skin].any()


def test_scalps_are_hidden_more_often_than_cheeks_and_a_few_heads_are_bare(lit: Tensor) -> None:
    planes = {name: torch.from_numpy(CHART.interpolate(vertex_mask(HEAD, name)[:, None])[..., 0] > 0.9)
              for name in ("scalp", "neck", "lips")}  # fmt: skip
    share = {name: float(lit[:, plane].mean()) for name, plane in planes.items()}
    assert share["scalp"] < 0.3 < share["neck"] + 0.15 < share["lips"], share
    inside = (lit.amax(0) > 0.99).float()
    bare = ((lit * inside).sum((1, 2)) > 0.98 * inside.sum()).float().mean()
    assert BARE / 3 < bare < 3 * BARE


def test_far_sides_are_hidden() -> None:
    """Seen from one side, and not mirrored: the two halves of the chart differ."""
    lit = COVER(geometry(200), torch.Generator().manual_seed(2))[:, 0]
    halves = (lit[:, :, : WIDTH // 2].sum((1, 2)) - lit[:, :, WIDTH // 2 :].sum((1, 2))) / lit.sum((1, 2))
    assert float((halves.abs() > 0.2).float().mean()) > 0.1
    assert abs(float(halves.mean())) < 0.05, "no side is preferred"


def test_a_head_without_face_towards_anybody_is_all_seen() -> None:
    """Normals of length 0 face no camera: the least is not reached, and nothing is divided by 0."""
    flat = geometry(3).clone()
    flat[:, 1:4] = 0.0
    lit = COVER(flat, torch.Generator().manual_seed(3))[:, 0]
    assert torch.isfinite(lit).all() and (lit.mean((1, 2)) > LEAST).all()


def test_no_light_is_measured_on_brows_and_beards_and_a_beard_everywhere_leaves_enough() -> None:
    """Lit skin in training alone, they would be shade to the network; with nothing left it would see nothing."""
    brows, cheeks = (torch.from_numpy(CHART.interpolate(vertex_mask(HEAD, *names)[:, None])[..., 0] > 0.9)
                     for names in (("brow_left", "brow_right"), ("cheek_left", "cheek_right")))  # fmt: skip
    seen = torch.from_numpy(CHART.part == HEAD.part_names.index("skin")).float().expand(60, 1, -1, -1)
    beard = torch.zeros_like(seen)
    beard[..., : WIDTH // 2] = 1.0
    generator = torch.Generator().manual_seed(4)
    left = COVER.measurable(seen, beard, generator)
    assert torch.isfinite(left).all() and left.min() >= 0.0 and (left <= seen).all()
    hidden = 1.0 - left / seen.clamp(min=0.5)
    assert 1.0 - 2.0 * UNREAD < float(hidden[:, 0, brows].mean()) <= 1.0
    bearded, bare = cheeks & (torch.arange(WIDTH) < WIDTH // 2), cheeks & (torch.arange(WIDTH) > WIDTH // 2 + 8)
    assert bearded.any() and 1.0 - 2.0 * UNREAD < float(hidden[:, 0, bearded].mean()) < 1.0
    assert bare.any() and float(hidden[:, 0, bare].mean()) < 0.05
    whole = COVER.measurable(seen, torch.ones_like(seen), generator)
    assert (whole.mean((1, 2, 3)) >= LEAST).all()
