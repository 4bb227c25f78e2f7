"""More skins than captures: the light stays what it was, and what is not skin's stays out of the numbers."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from models.colour import linear  # noqa: E402
from models.training.albedo import log_light  # noqa: E402
from models.training.skins import (  # noqa: E402
    ALIKE,
    BRIGHTEST,
    DARK,
    DARK_SCALE,
    FAIR,
    HUE,
    SCALE,
    SPREAD,
    darkened,
    fairness,
    recalibrated,
    relit,
)
from models.training.store import Arrays  # noqa: E402
from models.training.tasks import byte  # noqa: E402

pytestmark = pytest.mark.train


def item(albedo: float, texture: float) -> Arrays:
    """A capture of one colour."""
    return {
        "albedo": np.full((3, 8, 12), round(albedo * 255), np.uint8),
        "texture": np.full((2, 3, 8, 12), round(texture * 255), np.uint8),
        "geometry": np.ones((11, 8, 12), np.float16),
        "whites": np.arange(12, dtype=np.float32).reshape(2, 2, 3),
    }


def test_the_light_stays_when_the_skin_changes() -> None:
    """log(texture / albedo) before and after; skins too unlike each other are not exchanged."""
    one, other, far = item(0.5, 0.4), item(0.53, 0.9), item(0.9, 0.9)
    mixed = relit(one, 1, other)
    assert (mixed["albedo"] == other["albedo"]).all()
    before, after = (
        log_light(byte(np.asarray(each["texture"])[:1]), byte(np.asarray(each["albedo"]))[None])
        for each in (one, mixed)
    )
    assert torch.allclose(before, after, atol=0.02)
    assert (mixed["whites"] == one["whites"][1:]).all(), "the eyes are in the light that was taken"
    kept = relit(one, 1, far)
    assert (kept["albedo"] == one["albedo"]).all() and ALIKE < 1.0


def test_another_device_changes_the_albedo_and_not_the_exposure() -> None:
    """The texture keeps its brightness, so that what is taken for light makes up for the scale; drawn as documented."""
    n = 3000
    albedo, texture = torch.full((n, 3, 4, 6), 0.60), torch.full((n, 3, 4, 6), 0.6)
    assert float(fairness(albedo).min()) == 1.0
    shown, skin = recalibrated(texture, albedo, torch.Generator().manual_seed(3))
    assert linear(shown).log().mean((1, 2, 3)).sub(linear(texture).log().mean()).abs().max() < 1e-4
    scale = (linear(skin) / linear(albedo)).log()
    each = scale.mean((1, 2, 3))
    assert float(each.median()) == pytest.approx(SCALE, abs=0.05)
    lower = float(each.median() - each.quantile(0.16))
    assert lower == pytest.approx(SPREAD[0], rel=0.15), "the upper half may end at the brightest skin"
    hue = scale - scale.mean(1, keepdim=True)
    assert float(hue.std()) == pytest.approx(HUE * (2 / 3) ** 0.5, rel=0.15)
    light = log_light(shown, skin) - log_light(texture, albedo)
    assert torch.allclose(light, -scale.mean(1, keepdim=True).expand_as(light), atol=1e-3), "the hue is the skin's"


def test_no_skin_becomes_brighter_than_skin_and_black_stays_black() -> None:
    """Without the bound pale skin would clip to white; a black chart would divide by zero."""
    pale, dark = torch.full((200, 3, 4, 6), 0.93), torch.zeros((4, 3, 4, 6))
    _, skin = recalibrated(pale, pale, torch.Generator().manual_seed(4))
    assert float((linear(skin) / linear(pale)).max()) < np.exp(5 * HUE), "the scale is left out, the hue is not"
    assert linear(pale).max() < BRIGHTEST
    for chart in recalibrated(dark, dark, torch.Generator().manual_seed(5)):
        assert torch.isfinite(chart).all() and float(chart.max()) < 1e-3


def test_dark_skin_is_as_dark_as_it_was_measured() -> None:
    """By the mean of fair skin the darkest of training was half as bright again, and dark faces came out too bright."""
    albedo, texture = torch.full((400, 3, 4, 6), 0.22), torch.full((400, 3, 4, 6), 0.4)
    assert float(fairness(albedo).max()) == 0.0
    _, skin = recalibrated(texture, albedo, torch.Generator().manual_seed(6))
    assert float((linear(skin) / linear(albedo)).log().mean()) == pytest.approx(DARK_SCALE, abs=0.06)
    middle = torch.full((1, 3, 4, 6), float(np.exp((DARK + FAIR) / 2) ** (1 / 2.2)))
    assert 0.3 < float(fairness(middle)) < 0.7


def test_darker_skin_is_in_the_same_light() -> None:
    """Fair skin gets melanin on some charts, redder and darker; skin that is dark already does not; black is no NaN."""
    fair, texture = torch.full((200, 3, 4, 6), 0.75), torch.full((200, 3, 4, 6), 0.6)
    shown, skin = darkened(texture, fair, torch.Generator().manual_seed(7))
    assert torch.allclose(log_light(shown, skin), log_light(texture, fair), atol=2e-3)
    left = (linear(skin) / linear(fair)).mean((2, 3))
    changed = left[:, 1] < 0.99
    assert 0.15 < float(changed.float().mean()) < 0.45
    assert float(left[changed, 0].mean()) > float(left[changed, 2].mean()), "melanin absorbs blue most"
    dark = torch.full((50, 3, 4, 6), 0.1)
    assert torch.allclose(darkened(dark, dark, torch.Generator().manual_seed(8))[1], dark, atol=1e-4)
    assert torch.isfinite(darkened(0 * dark, 0 * dark, torch.Generator().manual_seed(9))[1]).all()
