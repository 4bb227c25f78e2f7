"""Creases: their normals are those of their relief, and darkness goes with depth."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")


from models.training import creases as drawn  # noqa: E402
from models.training.creases import FULL_WIDTH, Creases  # noqa: E402

pytestmark = pytest.mark.train

SIDE = 96


def some(monkeypatch: pytest.MonkeyPatch, count: int = 12, width: float = FULL_WIDTH, hair: float = 0.0) -> Creases:
    """Creases on every crop."""
    monkeypatch.setattr(drawn, "CREASED", 1.0)
    widths = torch.full((count, 1, 1, 1), width)
    cover = torch.full((count, 1, SIDE, SIDE), hair)
    return Creases.draw(count, SIDE, widths, cover, torch.Generator().manual_seed(2))


def test_slopes_belong_to_one_surface(monkeypatch: pytest.MonkeyPatch) -> None:
    """Slopes that are not those of a height would teach normals that no displacement can have."""
    made = some(monkeypatch)
    # Discrete curl of central differences: right differentiated downwards is minus up differentiated to the right.
    down = made.right[..., 2:, 1:-1] - made.right[..., :-2, 1:-1]
    across = made.up[..., 1:-1, 2:] - made.up[..., 1:-1, :-2]
    inner = (down + across)[..., 1:-1, 1:-1]
    assert float(inner.abs().max()) < 1e-3
    assert float(made.right.abs().max()) > 0.05 and torch.isfinite(made.density).all()


def test_the_normal_of_a_slope_leans_downhill(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wall that rises to the right looks to the left: a wrong sign would turn every crease into a ridge."""
    made = some(monkeypatch)
    flat = torch.zeros(12, 3, SIDE, SIDE)
    flat[:, 2] = 1.0
    normal = made.onto(flat, diffuse=False)
    assert torch.allclose(normal.square().sum(1), torch.ones(()), atol=1e-5)
    assert torch.allclose(-normal[:, :1] / normal[:, 2:], made.right, atol=1e-4)
    assert torch.allclose(-normal[:, 1:2] / normal[:, 2:], made.up, atol=1e-4)
    soft = made.onto(flat, diffuse=True)
    assert float(soft[:, :2].abs().mean()) < float(normal[:, :2].abs().mean()), "scattered light sees less of it"
