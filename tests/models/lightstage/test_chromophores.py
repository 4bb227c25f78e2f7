"""Colour of skin: published values, the table against the formula, inversion."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from models.lightstage.skin import chromophores as c  # noqa: E402

pytestmark = pytest.mark.train

def test_table_follows_the_formula() -> None:
    rng = np.random.default_rng(0)
    melanin, blood = 10 ** rng.uniform(-2.3, -0.3, 4000), 10 ** rng.uniform(-2.5, -1.0, 4000)
    depth, oxygen = rng.uniform(0.003, 0.013, 4000), rng.uniform(0.45, 0.88, 4000)
    exact = c.skin_rgb(melanin, blood, depth, oxygen)
    tensors = (torch.tensor(x, dtype=torch.float32)[None] for x in (melanin, blood, depth, oxygen))
    looked_up = c.ColourTable.build(0.8)(*tensors)[:, 0].numpy().T
    error = np.linalg.norm(c.lab(exact) - c.lab(looked_up), axis=1)
    assert error.mean() < 0.2
    assert error.max() < 0.6


def test_table_survives_absurd_pigment() -> None:
    values = torch.tensor([[-1.0, 0.0, 1e6]])
    colour = c.ColourTable.build(0.8)(values, values, torch.full_like(values, 0.008), torch.full_like(values, 5.0))
    assert torch.isfinite(colour).all()
    assert colour.min() >= 0
    assert colour.max() <= 1
