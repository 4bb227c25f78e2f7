"""Colour of skin: published values, the table against the formula, inversion."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from models.colour import srgb  # noqa: E402
from models.lightstage.skin import chromophores as c  # noqa: E402

pytestmark = pytest.mark.train

KNOWN = [  # melanin, blood, sRGB: computed independently when the model was designed
    (0.008, 0.006, (196, 174, 159)), (0.02, 0.008, (190, 161, 142)), (0.04, 0.010, (182, 146, 122)),
    (0.07, 0.012, (171, 128, 100)), (0.12, 0.012, (157, 110, 77)), (0.2, 0.012, (136, 87, 56)),
    (0.3, 0.012, (115, 69, 45)), (0.43, 0.012, (94, 55, 40)), (0.6, 0.012, (75, 47, 40)),
]  # fmt: skip


@pytest.mark.parametrize(("melanin", "blood", "expected"), KNOWN)
def test_known_colours(melanin: float, blood: float, expected: tuple[int, int, int]) -> None:
    coded = srgb(torch.tensor(c.skin_rgb(melanin, blood))) * 255
    assert np.abs(coded.numpy()[0] - expected).max() <= 1.5  # would break: a wrong table entry, unit or observer


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


@pytest.mark.parametrize("angle", [-60.0, -30.0, 0.0, 28.0, 55.0])
def test_inversion_finds_the_angle(angle: float) -> None:
    melanin = c.melanin_for_angle(angle, 0.011, 0.007, 0.7, 0.65)
    assert c.typology_angle(c.skin_rgb(melanin, 0.011, 0.007, 0.7, 0.65))[0] == pytest.approx(angle, abs=0.05)
