"""Crops of psi: pigment is no gloss; hair and lipstick are."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")

from models.colour import linear  # noqa: E402
from models.training.coverings import Coverings  # noqa: E402
from models.training.tasks import Batch  # noqa: E402

pytestmark = pytest.mark.train

COVERINGS = Coverings()
CHIN, FOREHEAD = (0.44, 0.55, 0.56, 0.73), (0.45, 0.10, 0.55, 0.25)
"""Parts of the chart: lips and beard, and bare skin."""


def crops(place: tuple[float, ...], count: int = 60, side: int = 64, level: float = 0.5) -> Batch:
    return {
        "albedo": torch.full((count, 3, side, side), level), "specular": torch.full((count, 1, side, side), 0.7),
        "place": torch.tensor([place] * count), "chart_width": torch.full((count, 1, 1, 1), 6144.0),
    }  # fmt: skip


def test_pigment_changes_colour_and_leaves_gloss() -> None:
    """Were the gloss changed with it, psi would learn that moles are dull and vitiligo shines."""
    for place in (CHIN, FOREHEAD):
        batch = crops(place)
        made = COVERINGS.pigmented(batch, torch.Generator().manual_seed(1))
        assert torch.equal(made["specular"], batch["specular"])
        change = (linear(made["albedo"]) / linear(batch["albedo"])).log()
        assert float(change.min()) < -0.5 < 0.2 < float(change.max())
        assert 0.3 < float((change.abs().amax((1, 2, 3)) > 0.01).float().mean()) < 1.0  # some stay plain


def test_hair_and_lipstick_lie_where_they_belong() -> None:
    """Strands are dark and dull, lipstick is red and shines; a forehead has neither."""
    bare = COVERINGS.covered(crops(FOREHEAD), torch.Generator().manual_seed(2))
    assert torch.allclose(bare["specular"], torch.tensor(0.7)) and torch.allclose(bare["albedo"], torch.tensor(0.5))
    batch = crops(CHIN)
    made = COVERINGS.covered(batch, torch.Generator().manual_seed(2))
    gloss, red = made["specular"], made["albedo"][:, :1] - made["albedo"][:, 1:2]
    dull, shining = gloss < 0.5, gloss > 0.75
    assert bool(dull.any()) and bool(shining.any())
    level = linear(made["albedo"]).mean(1, keepdim=True)
    assert float(level[dull].mean()) < 0.6 * float(linear(batch["albedo"]).mean())
    assert float(red[shining].mean()) > 0.1
    assert float(gloss.min()) > 0.2 and float(gloss.max()) <= 1.0


def test_a_mirrored_crop_has_its_marks_mirrored() -> None:
    """Lips of the chart's left half lie on the right of a mirrored crop of it."""
    left, top, right, bottom = (0.40, 0.5, 0.5, 0.75)
    plain, mirrored = (COVERINGS._at(crops(p, 1)) for p in ((left, top, right, bottom), (right, top, left, bottom)))
    assert float(plain[:, 1].max()) > 0.5
    assert torch.allclose(plain.flip(-1), mirrored, atol=1e-5)


def test_black_white_and_coarse_crops_stay_colours() -> None:
    """Strands thinner than a texel, and skin that has no room for paler pigment."""
    for level in (0.0, 1.0):
        batch = crops(CHIN, 20, level=level) | {"chart_width": torch.full((20, 1, 1, 1), 1536.0)}
        made = COVERINGS(batch, torch.Generator().manual_seed(3))
        for name in ("albedo", "specular"):
            assert made[name].isfinite().all() and made[name].min() >= 0.0 and made[name].max() <= 1.0
