"""The texture without its light, where the networks do not speak: eyes and teeth."""

from __future__ import annotations

import numpy as np

from service.anatomy.eye_painting import BRIGHTEST
from service.colour import linear_to_srgb, srgb_to_linear
from service.face.features.eye_colours import SCLERA
from service.reflectance.albedo.diffuse_albedo import light_between_lids, without


def test_the_white_of_an_eye_is_white_in_any_light() -> None:
    """In dim or coloured light eyes would else be darker than the skin, or of the light's opposite colour."""
    for factor in ([0.05, 0.05, 0.05], [0.9, 0.4, 0.2], [1.0, 1.0, 1.0]):
        coded = linear_to_srgb((SCLERA * factor).astype(np.float32)).reshape(1, 1, 3) * 2 - 1
        bare = without(np.log(np.array(factor, np.float32)), coded)
        assert np.allclose(srgb_to_linear(bare * 0.5 + 0.5)[0, 0], SCLERA, atol=2e-3)


def test_eyes_that_were_not_seen_lose_the_light_of_the_face() -> None:
    """Less what the lids shade; finite without any lit skin, and no tooth is brighter than a tooth can be."""
    light = np.full((3, 8, 12), -1.0, np.float32)
    light[:, :, :6] = 5.0
    lit = np.zeros((8, 12), np.float32)
    lit[:, 6:] = 1
    found = light_between_lids(light, lit)
    assert (found < -1.0).all() and (found > -2.0).all()
    assert np.isfinite(light_between_lids(light, 0 * lit)).all()
    bright = without(np.full(3, -50.0, np.float32), np.ones((2, 2, 3), np.float32))
    assert np.allclose(srgb_to_linear(bright * 0.5 + 0.5), BRIGHTEST, atol=2e-3)
