"""Light that reaches the whites of the eyes, by its direction."""

from __future__ import annotations

import numpy as np
import pytest

from service.head.files import load_head
from service.light.skin_light import BAND_GAIN, sh_basis
from service.light.sphere import spread_directions
from service.reflectance.corrections.sclera_depth import (
    LEAST,
    LIDS,
    MOST,
    SCLERA,
    SHALLOW,
    SLOPE,
    USUAL,
    beside_lids,
    in_usual_light,
)

HEAD = np.eye(3)
CAMERA = np.diag([1.0, -1.0, -1.0])
"""From head space (+Y up, +Z out) to a camera before the face (y down, z forward)."""


def from_direction(direction: tuple[float, float, float], ambient: float = 1.0) -> np.ndarray:
    """Second-order light (9, 3): even, and more from a direction."""
    d = np.asarray(direction) / np.linalg.norm(direction)
    return np.asarray((np.eye(9)[0] * ambient + 0.4 * (sh_basis(d[None]) / BAND_GAIN)[0])[:, None] * np.ones(3))


def test_light_from_above_reaches_the_whites_less() -> None:
    above, before = (beside_lids(from_direction(d), HEAD) for d in ((0.0, 1.0, 0.2), (0.0, 0.0, 1.0)))
    assert above < before - 0.15
    assert np.log(LEAST) <= above < before < 0.0


def test_the_frame_is_the_cameras_and_the_strength_cancels() -> None:
    """Light comes in the camera's frame, whose y goes down; taken for the head's, the sky would be below."""
    light = from_direction((0.3, 0.9, 0.2))
    turned = np.linalg.lstsq(
        sh_basis(spread_directions(64)) / BAND_GAIN,
        (sh_basis(spread_directions(64) @ CAMERA) / BAND_GAIN) @ light,
        rcond=None,
    )[0]
    expected = beside_lids(light, HEAD)
    assert beside_lids(turned, CAMERA) == pytest.approx(expected, abs=1e-6)
    assert beside_lids(100.0 * light, HEAD) == pytest.approx(expected, abs=1e-9)


def test_no_light_is_said_to_be_more_than_it_can_be() -> None:
    """Deeper shade counts as more light, by at most MOST, shallow eyes as less; what is not known stays so."""
    shown = np.array([0.3, 0.25, 0.2])
    above = from_direction((0.0, 1.0, 0.0), 0.5)
    more = in_usual_light(shown, above, HEAD)
    assert more is not None
    factor = np.exp(np.clip(-SLOPE * (beside_lids(above, HEAD) - USUAL), -MOST, MOST))
    assert np.allclose(more / shown, factor * np.exp(-SHALLOW)) and factor > 1.0
    assert in_usual_light(None, above, HEAD) is None
    assert np.allclose(np.asarray(in_usual_light(shown, None, HEAD)), shown * np.exp(-SHALLOW))


@pytest.mark.parametrize("light", [np.zeros((9, 3)), np.full((9, 3), np.nan), -from_direction((0, 0, 1))])
def test_lids_without_light_tell_nothing(light: np.ndarray) -> None:
    """A ratio to no light, or to the negative light of a bad fit, would be NaN or infinite in the network's input."""
    assert beside_lids(light, HEAD) == USUAL
    assert np.allclose(np.asarray(in_usual_light(np.ones(3), light, HEAD)), np.exp(-SHALLOW))


@pytest.mark.train
def test_the_tables_are_those_of_the_mean_head() -> None:
    """As rays cast by the light stage find them; the harmonics that turn over from side to side are 0."""
    pytest.importorskip("torch")
    from models.lightstage.light.sclera import DIRECTIONS, Whites

    head = load_head()
    basis = sh_basis(spread_directions(DIRECTIONS)) / BAND_GAIN * 4.0 / DIRECTIONS
    eyes = [eye for eye in Whites.of(head, head.mean).eyes if eye is not None]
    received = np.mean([[part.mean(0) for part in np.split(eye.sky.T @ basis, [eye.white])] for eye in eyes], 0)
    assert len(eyes) == 2 and np.allclose(received, [SCLERA, LIDS], atol=2e-3)
