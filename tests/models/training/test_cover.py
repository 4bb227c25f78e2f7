"""What training hides of the skin, as photos do."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")

from torch import Tensor  # noqa: E402

from models.networks.context import HEIGHT, WIDTH  # noqa: E402
from models.training.cover import LEAST, Cover  # noqa: E402
from service.geometry.chart import Chart  # noqa: E402
from service.head.files import load_head  # noqa: E402
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


def test_a_head_without_face_towards_anybody_is_all_seen() -> None:
    """Normals of length 0 face no camera: the least is not reached, and nothing is divided by 0."""
    flat = geometry(3).clone()
    flat[:, 1:4] = 0.0
    lit = COVER(flat, torch.Generator().manual_seed(3))[:, 0]
    assert torch.isfinite(lit).all() and (lit.mean((1, 2)) > LEAST).all()
