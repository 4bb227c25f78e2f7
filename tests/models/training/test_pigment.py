"""Pigment that follows no region: finite, bounded, on some charts and not on all, and no light."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")


import models.training.pigment as room  # noqa: E402
from models.training.albedo import log_light  # noqa: E402
from models.training.paint import Mark, Painter  # noqa: E402
from models.training.pigment import OFTEN, Pigment  # noqa: E402
from tests.models.training.charts import charts  # noqa: E402

pytestmark = pytest.mark.train

PIGMENT = Pigment()


def test_some_charts_have_patches_and_others_none() -> None:
    """A patch on every chart would be as usual as none; depths beyond 3 would be holes in the skin."""
    density = PIGMENT.density(60, torch.Generator().manual_seed(1))
    assert torch.isfinite(density).all()
    assert float(density.abs().max()) < 3.0
    bare = (density == 0).flatten(1).all(1).float().mean()
    assert abs(float(bare) - (1.0 - OFTEN) ** 7) < 0.2
    assert float(density.min()) < -0.1, "vitiligo is paler than the skin"


def test_each_kind_is_drawn_where_it_belongs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "OFTEN", 1.0)
    generator = torch.Generator().manual_seed(2)
    for kind in (PIGMENT._vitiligo, PIGMENT._melasma, PIGMENT._birthmark, PIGMENT._flush, PIGMENT._tan):
        drawn = torch.stack([kind(generator) for _ in range(12)])
        assert 0.0 <= float(drawn.min()) <= float(drawn.max()) <= 1.0 + 1e-5, kind.__name__
        assert float(drawn.amax((1, 2)).mean()) > 0.4, f"{kind.__name__} has to be seen at all"
    flushed = torch.stack([PIGMENT._flush(generator) for _ in range(6)]).mean(0)
    assert float(flushed[PIGMENT.middle < 0.01].max()) < 0.02, "skin flushes in the middle of the face"


def test_the_light_stays() -> None:
    """Pigment in the texture alone would be a shadow."""
    texture, albedo = charts(12, 0.5, 0.7)
    one = Mark(("lips",), (0.0, 0.0), (1.0, 1.0, 1.0), 0.0, 0.0)
    shown, skin = Painter((one,))(texture, albedo, torch.Generator().manual_seed(3))
    assert torch.allclose(log_light(shown, skin), log_light(texture, albedo), atol=2e-3)
    assert float((skin - albedo).abs().max()) > 0.05
