"""Marks on the skin: they change what is seen, and not the light."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")


from models.colour import linear  # noqa: E402
from models.training.albedo import log_light  # noqa: E402
from models.training.paint import MARKS, Painter  # noqa: E402
from tests.models.training.charts import charts  # noqa: E402

pytestmark = pytest.mark.train

PAINTER = Painter()


def test_the_light_stays_whatever_is_painted() -> None:
    """A mark in the texture alone would teach that brows are shade, which is what it is there to unlearn."""
    texture, albedo = charts(24, 0.6, 0.8)
    shown, skin = PAINTER(texture, albedo, torch.Generator().manual_seed(1))
    assert torch.allclose(log_light(shown, skin), log_light(texture, albedo), atol=1e-3)
    assert float((skin - albedo).abs().max()) > 0.2


def test_marks_lie_where_they_belong_and_reach_their_depth() -> None:
    for mark in MARKS:
        count, painter = round(45 / mark.often), Painter((mark,))  # of each some forty are painted
        place, density = painter.places[0], painter.density(count, torch.Generator().manual_seed(2))
        inside = place > 0.9
        assert torch.isfinite(density).all() and inside.any(), mark.regions
        depth = density[:, 1][:, inside].mean(1)
        most = mark.depth[1] * (1.0 + 3.0 * (mark.hues - 0.1)) + 0.4
        assert mark.depth[0] - 0.4 < float(depth.min()) < float(depth.max()) < most, mark.regions
        assert float(depth.max()) > 0.6 * mark.depth[1], mark.regions
    density = PAINTER.density(60, torch.Generator().manual_seed(2))
    nowhere = (torch.maximum(PAINTER.places, PAINTER.places.flip(-1)).amax(0) == 0).clone()
    nowhere[30:] = False  # the upper rim of the chart is far from all marks
    assert float(density[:, :, nowhere].abs().mean()) < 0.1


def test_both_sides_have_the_same_marks() -> None:
    """Brows come in pairs; what differs between the sides is light more often than paint."""
    density = PAINTER.density(200, torch.Generator().manual_seed(3)).mean(1)
    place = PAINTER.places[0] > 0.9
    left, right = density[:, place].mean(1), density[:, place.flip(-1)].mean(1)
    assert float(torch.corrcoef(torch.stack([left, right]))[0, 1]) > 0.9


def test_white_stays_white_and_black_stays_finite() -> None:
    """Paler marks on white would be cut off in the texture and not in the albedo, which would be light."""
    for value in (0.0, 1.0):
        texture, albedo = charts(8, value, 1.0)
        shown, skin = PAINTER(texture, albedo, torch.Generator().manual_seed(4))
        assert torch.isfinite(shown).all() and torch.isfinite(skin).all()
        assert float(linear(skin).max()) <= 1.0 + 1e-5
        assert torch.allclose(log_light(shown, skin), torch.zeros(()), atol=1e-3)
