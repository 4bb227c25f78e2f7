"""What training paints onto charts and crops: the light stays, codes stay codes, and extremes stay finite."""

from __future__ import annotations

from collections.abc import Callable

import pytest

torch = pytest.importorskip("torch")

from torch import Generator, Tensor  # noqa: E402

from models.colour import linear  # noqa: E402
from models.training import creases  # noqa: E402
from models.training.albedo import log_light  # noqa: E402
from models.training.coverings import Coverings  # noqa: E402
from models.training.degrade import graded, noisy, tinted  # noqa: E402
from models.training.facial_hair import Barber  # noqa: E402
from models.training.openings import whitened  # noqa: E402
from models.training.paint import Mark, Painter  # noqa: E402
from models.training.regions import region_planes  # noqa: E402
from models.training.shadows import hard_light  # noqa: E402
from models.training.skins import darkened, recalibrated  # noqa: E402
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
    texture, skin = charts(8, albedo, light)
    shown, changed = ON_SKIN[name](texture, skin, Generator().manual_seed(1))
    assert torch.isfinite(shown).all() and torch.isfinite(changed).all()
    assert torch.allclose(log_light(shown, changed), log_light(texture, skin), atol=2e-2)
    assert float(linear(changed).max()) <= 1.0 + 1e-5
    if albedo == 0.7:
        assert float((changed - skin).abs().max()) > 0.05, "something is done"
    again = ON_SKIN[name](texture, skin, Generator().manual_seed(1))
    assert torch.equal(again[1], changed)


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


@pytest.mark.parametrize("name", OF_PHOTOS)
@pytest.mark.parametrize("level", [0.0, 0.5, 0.93, 1.0])
def test_codes_stay_codes(name: str, level: float) -> None:
    made = OF_PHOTOS[name](torch.full((60, 3, 8, 12), level), Generator().manual_seed(5))
    assert made.isfinite().all() and float(made.min()) >= 0.0 and float(made.max()) <= 1.0 + 1e-6


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("width", [6144.0, 1536.0])
def test_coverings_and_creases_stay_colours(level: float, width: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Strands thinner than a texel, and skin that has no room for paler pigment."""
    batch = {
        "albedo": torch.full((20, 3, 64, 64), level), "specular": torch.full((20, 1, 64, 64), 0.7),
        "place": torch.tensor([(0.44, 0.55, 0.56, 0.73)] * 20), "chart_width": torch.full((20, 1, 1, 1), width),
    }  # fmt: skip
    made = COVERINGS(batch, Generator().manual_seed(3))
    monkeypatch.setattr(creases, "CREASED", 1.0)
    drawn = creases.Creases.draw(20, 64, batch["chart_width"], torch.zeros(20, 1, 64, 64), Generator().manual_seed(2))
    for codes in (made["albedo"], made["specular"], drawn.seen(batch["albedo"])):
        assert codes.isfinite().all() and codes.min() >= 0.0 and codes.max() <= 1.0


def test_pigment_changes_colour_and_leaves_gloss() -> None:
    """Else psi would learn that moles are dull and vitiligo shines."""
    batch = {
        "albedo": torch.full((60, 3, 64, 64), 0.5), "specular": torch.full((60, 1, 64, 64), 0.7),
        "place": torch.tensor([(0.45, 0.10, 0.55, 0.25)] * 60), "chart_width": torch.full((60, 1, 1, 1), 6144.0),
    }  # fmt: skip
    made = COVERINGS.pigmented(batch, Generator().manual_seed(1))
    assert torch.equal(made["specular"], batch["specular"])
    assert float((made["albedo"] - batch["albedo"]).abs().max()) > 0.1


def test_hair_grows_where_hair_grows() -> None:
    texture, skin = charts(16, 0.7, 0.8)
    apart = (BARBER(texture, skin, Generator().manual_seed(2))[1] - skin).abs().amax((0, 1))
    for bare in region_planes(("eyelid_lower_left",), ("nose_tip",)):
        assert float(apart[bare > 0.9].max()) < 0.05
    for name in ("moustache", "chin", "jaw", "brow"):
        assert float(apart[getattr(BARBER.places, name) > 0.8].max()) > 0.1, name


def test_teeth_are_painted_inside_of_mouths_alone() -> None:
    """Paint on a lip would move the edge that is the truth; nothing is as bright as skin in black: white is black."""
    image = torch.full((60, 3, 64, 64), 120, dtype=torch.uint8)
    mouth = torch.zeros((60, 1, 64, 64), dtype=torch.uint8)
    mouth[:, :, 28:36, 12:52] = 255
    shown = whitened(image, mouth, Generator().manual_seed(1))
    outside = (mouth == 0).expand_as(image)
    assert shown.dtype == torch.uint8 and torch.equal(shown[outside], image[outside])
    assert not whitened(0 * image, mouth, Generator().manual_seed(2)).any()
