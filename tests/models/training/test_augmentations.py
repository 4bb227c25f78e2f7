"""What training paints onto charts and crops: the light stays, codes stay codes, and extremes stay finite."""

from __future__ import annotations

from collections.abc import Callable

import pytest

torch = pytest.importorskip("torch")

from torch import Generator, Tensor  # noqa: E402

from models.colour import linear  # noqa: E402
from models.training.albedo import log_light  # noqa: E402
from models.training.coverings import Coverings  # noqa: E402
from models.training.degrade import graded, noisy, tinted  # noqa: E402
from models.training.facial_hair import Barber  # noqa: E402
from models.training.paint import Mark, Painter, moved  # noqa: E402
from models.training.shadows import hard_light  # noqa: E402
from models.training.skins import darkened, recalibrated, relit  # noqa: E402
from models.training.specular_albedo import retoned  # noqa: E402
from service.runtime.network_registry import GEOMETRY  # noqa: E402
from tests.models.training.charts import charts  # noqa: E402

pytestmark = pytest.mark.train

BARBER, PAINTER, COVERINGS = Barber(), Painter(), Coverings()
LIPS = Painter((Mark(("lips",), (0.0, 0.0), (1.0, 1.0, 1.0), 0.0, 0.0),))
"""With pigment that follows no region besides."""

Change = Callable[[Tensor, Tensor, Generator], tuple[Tensor, Tensor]]
ON_SKIN: dict[str, Change] = {
    "facial hair": lambda texture, albedo, chance: BARBER(texture, albedo, chance)[:2],
    "marks": PAINTER,
    "pigment": LIPS,
    "melanin": darkened,
}


@pytest.mark.parametrize("name", ON_SKIN)
@pytest.mark.parametrize(("albedo", "light"), [(0.7, 0.8), (0.25, 1.0), (1.0, 1.0), (0.0, 1.0)])
def test_the_light_stays_whatever_grows_or_is_painted(name: str, albedo: float, light: float) -> None:
    """In the texture alone it would teach that brows are shade. Black and white are cut off on neither side alone."""
    texture, skin = charts(24, albedo, light)  # so many that each change meets one
    shown, changed = ON_SKIN[name](texture, skin, Generator().manual_seed(1))
    assert torch.isfinite(shown).all() and torch.isfinite(changed).all()
    assert torch.allclose(log_light(shown, changed), log_light(texture, skin), atol=2e-2)
    assert float(linear(changed).max()) <= 1.0 + 1e-5
    if albedo == 0.7:
        assert float((changed - skin).abs().max()) > 0.05, "something is done"
    again = ON_SKIN[name](texture, skin, Generator().manual_seed(1))
    assert torch.equal(again[1], changed)


def test_another_skin_lies_in_the_same_light() -> None:
    """Light that changed with the skin would be learnt as light; on much darker skin the surface mirrors more of it."""
    texture, skin = charts(24, 0.5, 0.8)
    mask = torch.ones_like(skin[:, :1])
    shown, worn = relit(texture, skin, 0.9 * skin, mask, Generator().manual_seed(1))
    swapped = (worn - skin).abs().amax((1, 2, 3)) > 0.01
    assert 4 <= int(swapped.sum()) <= 20, "about half of the charts wear the other's skin"
    assert torch.allclose(log_light(shown, worn), log_light(texture, skin), atol=2e-2)
    unlike = relit(texture, skin, 0.2 * skin, mask, Generator().manual_seed(1))
    assert torch.equal(unlike[0], texture) and torch.equal(unlike[1], skin)


def test_marks_are_moved_and_enlarged_each_by_itself() -> None:
    """A quarter of a chart's half to the right, and twice as large about its own middle."""
    image = torch.zeros(1, 2, 64, 64)
    image[:, 0, 28:36, 28:36] = 1.0
    image[:, 1, 12:20, 44:52] = 1.0
    shift, size = torch.tensor([[[0.25, 0.0], [0.0, 0.0]]]), torch.tensor([[[1.0, 1.0], [2.0, 2.0]]])
    one, two = moved(image, shift, size)[0]
    assert one.sum() == pytest.approx(64.0, rel=0.05) and float(one[28:36, 36:44].mean()) > 0.9
    assert two.sum() == pytest.approx(256.0, rel=0.1) and float(two[9:23, 41:55].mean()) > 0.9


OF_PHOTOS: dict[str, Callable[[Tensor, Generator], Tensor]] = {
    "tone curve": graded,
    "coloured lamp": tinted,
    "noise": noisy,
    "hard light without shape": lambda texture, chance: hard_light(
        texture, torch.zeros(len(texture), len(GEOMETRY), *texture.shape[2:]), chance
    ),
    "another tone": retoned,
    "another device": lambda texture, chance: recalibrated(texture, texture, chance)[1],
}


def test_pigment_changes_colour_and_leaves_gloss() -> None:
    """Else psi would learn that moles are dull and vitiligo shines."""
    batch = {
        "albedo": torch.full((60, 3, 64, 64), 0.5), "specular": torch.full((60, 1, 64, 64), 0.7),
        "place": torch.tensor([(0.45, 0.10, 0.55, 0.25)] * 60), "chart_width": torch.full((60, 1, 1, 1), 6144.0),
    }  # fmt: skip
    made = COVERINGS.pigmented(batch, Generator().manual_seed(1))
    assert torch.equal(made["specular"], batch["specular"])
    assert float((made["albedo"] - batch["albedo"]).abs().max()) > 0.1
