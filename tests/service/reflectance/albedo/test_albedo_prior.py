"""The albedo of a whole head from what is seen of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from service.errors import ModelFault
from service.geometry.chart import Chart
from service.head.files import load_head
from service.head.regions import vertex_mask
from service.reflectance.albedo.albedo_prior import FILE, AlbedoPrior, albedo_prior
from service.reflectance.albedo.light_corrections import as_seen_skin, continued

H, W = 16, 24


def toy(noise: float = 0.1) -> AlbedoPrior:
    """One component: the right half becomes brighter as the left one does, twice as much."""
    component = np.full((1, 3, H, W), 0.5, np.float32)
    component[..., W // 2 :] = 1.0
    return AlbedoPrior(np.full((3, H, W), -1.0, np.float32), component, noise, np.ones((H, W), np.float32))


def test_a_file_that_is_none_is_said(tmp_path: Path) -> None:
    with pytest.raises(ModelFault, match=r"prior\.npz"):
        AlbedoPrior.read(tmp_path / "prior.npz")
    path = tmp_path / "prior.npz"
    np.savez(path, mean=np.zeros((3, 2, 2)), components=np.zeros((1, 3, 4, 4)), inside=np.ones((2, 2)), noise=1.0)
    with pytest.raises(ModelFault, match="islands"):
        AlbedoPrior.read(path)


def test_unseen_skin_gets_what_goes_with_the_seen_and_no_step() -> None:
    """Half a chart in even light; the rest was inpainted in grey: its albedo follows the component."""
    prior, lit = toy(1e-3), np.zeros((H, W), np.float32)
    lit[:, : W // 2] = 1
    albedo = np.full((3, H, W), -1.0 + 0.5 * 0.6, np.float32)
    albedo[..., W // 2 :] = -1.0 + 0.6
    texture = np.exp(albedo)
    texture[..., W // 2 :] = 0.2
    light = np.zeros((3, H, W), np.float32)
    made = np.log(texture) - as_seen_skin(continued(light, lit), texture, light, lit, 1 - lit, lit, prior)
    far = slice(W - 4, W)
    assert made[..., far] == pytest.approx(albedo[..., far], abs=0.03)
    alone = np.log(texture) - as_seen_skin(continued(light, lit), texture, light, lit, 1 - lit, lit)
    assert np.abs(alone[..., far] - albedo[..., far]).mean() > 0.2


def test_the_prior_in_the_box_is_of_the_head_in_the_box() -> None:
    """Lips are redder than cheeks in everybody, and one seen cheek tells a tone: dark stays dark all over."""
    head, prior = load_head(None), albedo_prior(bearded=True)
    chart = Chart.build(head, 288, 192)
    assert prior.is_of(chart.mask.astype(np.float32))
    lips, cheek, ear = (
        chart.interpolate(vertex_mask(head, n))[..., 0] > 0.5 for n in ("lips", "cheek_left", "ear_right")
    )
    scalp, forehead = (chart.interpolate(vertex_mask(head, n))[..., 0] > 0.9 for n in ("scalp", "forehead"))
    for level in (-3.0, -0.9):
        seen = np.full((3, 192, 288), level, np.float32) + np.array([0.25, 0.0, -0.2], np.float32)[:, None, None]
        made = prior.complete(seen, cheek.astype(np.float32))
        redness = made[0] - made[1]
        assert redness[lips].mean() > redness[cheek].mean()
        assert made[:, ear].mean() == pytest.approx(level, abs=0.5)
        assert made[:, scalp].mean(1) == pytest.approx(made[:, forehead].mean(1), abs=0.12), "a crown without stubble"
    assert FILE.is_file()
