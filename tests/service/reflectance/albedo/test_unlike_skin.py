"""What no skin is like goes to the light; moles, lips and plain skin stay."""

from __future__ import annotations

import numpy as np
import pytest

from service.arrays import Float32
from service.image_filters import stretched_to
from service.reflectance.albedo.albedo_prior import albedo_prior
from service.reflectance.albedo.unlike_skin import within_bounds

PRIOR = albedo_prior(bearded=False)
SIZE = (288, 192)
MEAN = np.stack([stretched_to(plane, SIZE) for plane in PRIOR.mean])
LIT = stretched_to(PRIOR.inside, SIZE)
LIT[:24] = LIT[150:] = LIT[:, :64] = LIT[:, -64:] = 0  # the face
FOREHEAD, CHEEK, LIPS = np.s_[:, 34:52, 110:178], np.s_[:, 100:118, 90:114], np.s_[:, 118:132, 130:158]
DARK = np.log(np.full((3, 1, 1), 0.25, np.float32))


def change(painted: Float32) -> Float32:
    """(3, h, w) of the light by which a face painted over its mean is brought to the albedo that is left."""
    return within_bounds(np.zeros_like(MEAN), np.exp(MEAN + painted), LIT, PRIOR)


def painted(place: tuple[slice, ...], logs: Float32) -> Float32:
    field = np.zeros_like(MEAN)
    field[place] = logs
    return field


def test_plain_skin_stays() -> None:
    assert np.abs(change(np.zeros_like(MEAN))).max() < 0.03


def test_a_shadow_with_a_hard_edge_is_light() -> None:
    light = change(painted(FOREHEAD, DARK))
    inside = np.s_[:, 38:48, 116:172]
    left = DARK - light[inside]
    assert left.min() > -0.6  # of -1.39: skin in the shadow is no darker than some people's
    assert np.abs(light[CHEEK]).max() < 0.05  # and the rest is as it was


@pytest.mark.parametrize("channel", [0, 2])
def test_a_patch_of_coloured_light_is_light(channel: int) -> None:
    lamp = np.zeros((3, 1, 1), np.float32)
    lamp[channel] = -0.9
    left = (lamp - change(painted(CHEEK, lamp)))[:, 104:114, 94:110]
    assert np.median(np.abs(left[channel] - left[1])) < 0.32  # of 0.9


def test_moles_stay() -> None:
    place = np.s_[:, 108:110, 100:102]
    assert np.abs(change(painted(place, DARK))[place]).max() < 0.15


def test_lipstick_stays() -> None:
    red = np.array([0.1, -0.7, -0.6], np.float32)[:, None, None]
    assert np.abs(change(painted(LIPS, red))[:, 121:129, 136:152]).max() < 0.15


def test_without_skin_the_light_stays() -> None:
    light = np.zeros_like(MEAN)
    assert within_bounds(light, np.exp(MEAN), np.zeros_like(LIT), PRIOR) is light
