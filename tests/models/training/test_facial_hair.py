"""Painted hair: it covers skin where hair grows, and the light stays."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")


import models.training.facial_hair as hair  # noqa: E402
from models.colour import linear  # noqa: E402
from models.networks.context import HEIGHT  # noqa: E402
from models.training.albedo import log_light  # noqa: E402
from models.training.facial_hair import COLOURS, Barber  # noqa: E402
from models.training.regions import region_planes  # noqa: E402
from tests.models.training.charts import charts  # noqa: E402

pytestmark = pytest.mark.train

BARBER = Barber()


@pytest.mark.parametrize(("albedo", "light"), [(0.7, 0.8), (0.25, 1.0), (1.0, 1.0), (0.0, 1.0)])
def test_the_light_stays_whatever_grows(albedo: float, light: float) -> None:
    """Black skin and white hair are the extremes: neither is cut off on one side only."""
    texture, skin = charts(12, albedo, light)
    shown, grown, beard = BARBER(texture, skin, torch.Generator().manual_seed(1))
    assert beard.shape == (12, 1, *skin.shape[2:]) and beard.min() >= 0.0 and beard.max() <= 1.0
    assert torch.isfinite(shown).all() and torch.isfinite(grown).all()
    assert torch.allclose(log_light(shown, grown), log_light(texture, skin), atol=2e-2)


def test_hair_grows_where_hair_grows() -> None:
    texture, skin = charts(40, 0.7, 0.8)
    _, grown, _ = BARBER(texture, skin, torch.Generator().manual_seed(2))
    apart = (grown - skin).abs().amax((0, 1))
    cheeks, forehead, nose, lips = region_planes(("eyelid_lower_left",), ("forehead",), ("nose_tip",), ("lips",))
    for bare in (cheeks > 0.9, nose > 0.5):
        assert float(apart[bare].max()) < 0.05
    middle = (forehead > 0.9) & (torch.arange(HEIGHT)[:, None] < 20)
    assert not bool(middle.any()) or float(apart[middle].max()) < 0.02
    changed = ((grown - skin).abs().amax(1) > 0.05).float().mean(0)
    places = BARBER.places
    for name in ("moustache", "chin", "jaw"):
        share = float(changed[getattr(places, name) > 0.8].mean())
        assert 0.1 < share < 0.6, name
    assert float(changed[places.brow > 0.8].mean()) > 0.2
    assert float(apart[lips > 0.95].mean()) < float(apart[places.chin > 0.8].mean())


def test_full_beards_have_the_colour_of_hair_and_shadows_stay_skin(monkeypatch: pytest.MonkeyPatch) -> None:
    """By optical depth 8 nothing of the skin is left; a shaved beard is never darker than its roots make it."""
    monkeypatch.setattr(hair, "BEARDED", 1.0)
    monkeypatch.setattr(hair, "BROWED", 0.0)
    monkeypatch.setattr(hair, "BEARD_DENSITY", (8.0, 9.0))
    texture, skin = charts(24, 0.8, 0.9)
    _, grown, _ = BARBER(texture, skin, torch.Generator().manual_seed(3))
    darkest = linear(grown).amin((1, 2, 3))
    shaved = linear(skin)[0, 0, 0, 0] * torch.exp(torch.tensor(-2.0 * hair.SHAVED))
    full = darkest < 0.8 * float(COLOURS.max())
    assert 0.4 < float(full.float().mean()) < 1.0
    assert float(darkest[~full].min()) > 0.95 * float(shaved)


def test_the_same_seed_grows_the_same_beard() -> None:
    texture, skin = charts(3, 0.6, 0.9)
    one, other = (BARBER(texture, skin, torch.Generator().manual_seed(4))[1] for _ in range(2))
    assert torch.equal(one, other)
