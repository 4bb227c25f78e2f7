"""Hair, and all else that is no lit skin, says nothing of the light on the face."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from service.colour import FULL_CODE, linear_to_srgb
from service.geometry.chart import Chart
from service.head.files import load_head
from service.head.regions import vertex_mask
from service.reflectance.albedo.diffuse_albedo import LIGHT_NETWORK, found_by
from service.reflectance.planes import Planes
from service.reflectance.subject import GEOMETRY_SIZE, Subject
from service.runtime.network_registry import CLUES, GEOMETRY, LIT, SHOWN
from service.runtime.networks import Engine, open_network

HEAD = load_head(None)
SIZE = (288, 192)
SKIN = np.array([0.40, 0.23, 0.16], np.float32)
CHART = Chart.build(HEAD, *SIZE)


def plane(*names: str) -> np.ndarray:
    """(h, w) of regions of the head on the context's chart."""
    return np.asarray(CHART.interpolate(vertex_mask(HEAD, *names)[:, None])[..., 0] * CHART.mask, np.float32)


def clue(subject: Subject, name: str) -> np.ndarray:
    """(h, w) one of the subject's clues."""
    return np.asarray(subject.clues[CLUES.index(name)])


def test_hair_of_any_colour_leaves_the_light_of_the_face() -> None:
    """The network in the box, and a face from the side in black, blond and no hair.

    Heads of the light stage are bald. A network that looks at hair takes black hair for deep shade and the face below
    it for brightly lit: on albedo maps of real people that have a cap of black, that cost 5 dB.
    """
    hair = plane("scalp") > 0.4
    subject = replace(Subject.of(HEAD, HEAD.mean), lit=np.where(hair, 0, 1).astype(np.float32))
    sideways = subject.geometry[GEOMETRY.index("normal_object_x")]
    lit_face = SKIN * np.exp(0.6 * cv2.resize(sideways, SIZE, interpolation=cv2.INTER_AREA))[..., None]
    face = plane("face") > 0.9
    lights = []
    with open_network(LIGHT_NETWORK, Engine(threads=2)) as network:
        assert LIT in network.description.channels
        for colour in ((0.008, 0.007, 0.006), (0.45, 0.33, 0.18), SKIN):
            linear = np.where(hair[..., None], np.asarray(colour, np.float32), lit_face).astype(np.float32)
            planes = Planes(SIZE)
            planes.add_codes("texture", np.rint(linear_to_srgb(linear) * FULL_CODE).astype(np.uint16))
            planes.add_coarse(GEOMETRY, subject.geometry)
            planes.add_coarse(CLUES, subject.clues)
            lights.append(found_by(network, planes).light)
    for other in lights[1:]:
        # Texels of the hairline are shared by both.
        assert np.abs((other - lights[0])[:, face & ~hair]).mean() < 0.01
    sides = lights[0].mean(0)[face]
    right = (np.arange(SIZE[0]) > SIZE[0] / 2) * np.ones((SIZE[1], 1), bool)
    found = sides[right[face]].mean() - sides[~right[face]].mean()
    told = np.log(lit_face.mean(2))[face]
    assert found == pytest.approx(told[right[face]].mean() - told[~right[face]].mean(), rel=0.6), "it sees the face"


def test_a_beard_is_shown_and_inpainted_skin_and_the_shadow_of_a_cap_are_not() -> None:
    """What completes unseen skin goes by beards too, but not by all that is dark: a cap's shadow would grow on."""
    beard, forehead = (cv2.resize(plane(name), GEOMETRY_SIZE) > 0.9 for name in ("beard", "forehead"))
    inpainted = np.zeros(GEOMETRY_SIZE[::-1], np.float32)
    inpainted[:, : GEOMETRY_SIZE[0] // 2] = 1
    lit = np.asarray((1 - inpainted) * ~beard, np.float32)
    subject = replace(Subject.of(HEAD, HEAD.mean), lit=lit, inpainted=inpainted)
    shown, seen = clue(subject, SHOWN), inpainted == 0
    assert clue(subject, LIT)[beard].max() == 0
    assert shown[beard & seen].min() > 0.5
    assert shown[~seen].max() == 0 and shown[forehead].max() == 0


def test_eyes_teeth_and_all_outside_are_no_lit_skin() -> None:
    """Whatever the texture stage says of their texels: training has no light there either."""
    skin = Chart.build(HEAD, *GEOMETRY_SIZE).part == HEAD.part_names.index("skin")
    for lit in (None, np.ones((64, 96), np.float32)):
        found = clue(replace(Subject.of(HEAD, HEAD.mean), lit=lit), LIT)
        assert not found[~skin].any() and found[skin].min() == 1


def test_a_photo_without_lit_skin_counts_whole() -> None:
    """The mean over nothing would be divided by; all skin is as good a guess as any."""
    nothing = np.zeros((64, 96), np.float32)
    subject = Subject.of(HEAD, HEAD.mean)
    assert np.array_equal(clue(replace(subject, lit=nothing), LIT), clue(subject, LIT))
