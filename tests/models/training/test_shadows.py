"""Painted hard light: shadows only where the lamp reaches, highlights where the surface mirrors it."""

from __future__ import annotations

import math

import pytest

torch = pytest.importorskip("torch")

from torch import Tensor  # noqa: E402

import models.training.shadows as shadows  # noqa: E402
from models.training.shadows import directions, highlight, shadow  # noqa: E402
from service.runtime.network_registry import GEOMETRY  # noqa: E402

pytestmark = pytest.mark.train


def sphere(n: int, height: int = 32, width: int = 48) -> Tensor:
    """(n, 11, h, w) geometry of the front half of a ball of 100 mm: x over the chart, y down it."""
    y, x = torch.meshgrid(torch.linspace(0.95, -0.95, height), torch.linspace(-0.95, 0.95, width), indexing="ij")
    x = x * (1 - y * y).sqrt()
    normal = torch.stack([x, y, (1 - x * x - y * y).clamp(min=0).sqrt()])
    geometry = torch.zeros(n, len(GEOMETRY), height, width)
    for k, axis in enumerate("xyz"):
        geometry[:, GEOMETRY.index(f"normal_object_{axis}")] = normal[k]
        geometry[:, GEOMETRY.index(f"position_{axis}")] = normal[k] * 100 / 128
    geometry[:, -1] = 1.0
    return geometry


def test_shadows_darken_where_the_lamp_reaches_and_nowhere_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shadows, "SHADOWED", 1.0)
    geometry, generator = sphere(32), torch.Generator().manual_seed(1)
    towards = directions(32, generator)
    normal = geometry[:, shadows._NORMAL]
    dark = shadow(geometry[:, shadows._POSITION], normal, towards, generator)
    facing = torch.einsum("nchw,nc->nhw", normal, towards)[:, None].expand_as(dark)
    assert torch.isfinite(dark).all() and float(dark.min()) >= 0.0
    assert float(dark[facing <= 0].max()) == 0.0
    assert 0.2 < float((dark[facing > 0.3] > 0.1).float().mean()) < 0.9
    assert float(dark.max()) < shadows.DEPTH[1] * math.exp(5 * shadows.TINT)


def test_highlights_lie_half_way_between_lamp_and_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blinn: the brightest texel has the normal that halves the angle, here exactly on the grid for a frontal lamp."""
    monkeypatch.setattr(shadows, "SHINING", 1.0)
    normal = sphere(8, 33, 49)[:, shadows._NORMAL]
    towards = torch.tensor([[0.0, 0.0, 1.0]]).expand(8, 3)
    monkeypatch.setattr(shadows, "smooth_field", lambda shape, cells, generator: torch.zeros(shape))
    bright = highlight(normal, towards, torch.Generator().manual_seed(3))
    assert float(bright.min()) >= 0.0
    for one in bright:
        peak = int(one[0].argmax())
        assert divmod(peak, 49) == (16, 24)
        assert float(one.max()) <= shadows.BRIGHTEST * math.exp(5 * shadows.TINT)
