"""Light on the whites of the eyes: what brows and lids take from above, and what closed or missing eyes give."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from models.lightstage.light.sclera import Whites  # noqa: E402
from service.head.files import load_head  # noqa: E402
from service.light.environment import (  # noqa: E402
    HEIGHT,
    WIDTH,
    Illumination,
    pixel_directions,
)
from service.light.scene import PointLight  # noqa: E402

pytestmark = pytest.mark.train

DARK = np.zeros((HEIGHT, WIDTH, 3))


@pytest.fixture(scope="module")
def whites() -> Whites:
    head = load_head()
    return Whites.of(head, head.mean)


def lamp(x: float, y: float, z: float = 0.8, strength: float = 1.0) -> Illumination:
    return Illumination((PointLight((x, y, z), (strength,) * 3, 0.02),), DARK)


def test_brows_and_lids_keep_light_from_the_whites(whites: Whites) -> None:
    """An even light reaches them less than the lids, a lamp before the face more, one above the brows hardly."""
    even, before, above = (
        whites.beside_lids(light) for light in (Illumination((), DARK + 1.0), lamp(0.0, 0.0), lamp(0.0, 1.4))
    )
    assert -1.0 < even.max() < -0.1
    assert before.min() > 0.1
    assert above.max() < -1.0


def test_the_sky_and_a_lamp_as_wide_agree(whites: Whites) -> None:
    """Two ways to compute one light: as a patch of the sky, and as a ball far away that is as wide."""
    at = np.array([0.35, 0.35, 0.87])
    at /= np.linalg.norm(at)
    wide = np.radians(14.0)
    patch = np.where(pixel_directions(HEIGHT, WIDTH) @ at[:, None] > np.cos(wide), 1.0, DARK)
    far = 50.0 * at
    ball = PointLight((float(far[0]), float(far[1]), float(far[2])), (1.0, 1.0, 1.0), 50.0 * float(np.sin(wide)))
    sky, lamp_ = (whites.beside_lids(light) for light in (Illumination((), patch), Illumination((ball,), DARK)))
    assert np.allclose(sky, lamp_, atol=0.12)


def test_no_light_is_no_ratio_of_nothing_and_closed_eyes_are_unseen(whites: Whites) -> None:
    """Black would be the logarithm of 0; closed eyes would be told by the few points that the lids leave open."""
    assert (whites.beside_lids(Illumination((), DARK)) == 0.0).all()
    head = load_head()
    blinks = [head.expression_names.index(f"eyeBlink{side}") for side in ("Left", "Right")]
    closed = head.mean + head.expression[blinks].sum(0)
    assert np.isnan(Whites.of(head, closed).beside_lids(lamp(0.0, 0.0))).all()
    blind = replace(head, part_names=tuple(name.replace("eye_", "marble_") for name in head.part_names))
    assert np.isnan(Whites.of(blind, head.mean).beside_lids(lamp(0.0, 0.0))).all()
