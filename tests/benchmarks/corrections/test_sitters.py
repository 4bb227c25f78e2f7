"""What is painted and worn lies where it should, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")

from benchmarks.corrections import hair, worn
from benchmarks.corrections.photos import DEVELOPED, GROUPS, QUICK, SITTINGS, names
from benchmarks.corrections.sitters import BORDER, whole_skin
from benchmarks.heads import TexturedHead, at_places, places_of, subdivided
from tests.toyhead import CENTRE, EYE_RADIUS, EYE_X, sphere_head

BLACK = (0.01, 0.01, 0.01)


def face() -> TexturedHead:
    """A ball of a head, fine enough to paint on, and fair."""
    toy = sphere_head()
    skin = toy.triangles[toy.triangle_part == toy.part_names.index("skin")]
    vertices, triangles = subdivided(toy.mean.astype(np.float64), skin.astype(np.int64), 3)
    eyes = np.array([[EYE_X, 0, 0], [-EYE_X, 0, 0]])
    return TexturedHead("toy", vertices, triangles, np.full((len(vertices), 3), 0.5), eyes, EYE_RADIUS)


def landmarks() -> np.ndarray:
    """(68, 3) of a round face: only those that are drawn by have to be right."""
    points = np.zeros((68, 3))
    turn = np.linspace(-1.5, 1.5, 17)
    points[:17, :2] = np.stack([0.07 * np.sin(turn), -0.02 - 0.06 * np.cos(turn)], 1)
    points[17:22, :2] = np.stack([np.linspace(-0.05, -0.012, 5), np.full(5, 0.025)], 1)
    points[22:27, :2] = np.stack([np.linspace(0.012, 0.05, 5), np.full(5, 0.025)], 1)
    points[31, :2], points[35, :2] = (-0.012, -0.03), (0.012, -0.03)
    lips = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    points[48:60, :2] = np.stack([-0.02 * np.cos(lips), -0.05 + 0.007 * np.sin(lips)], 1)
    return points


def test_brows_lie_over_the_eyes_and_a_beard_below_the_nose_round_the_lips() -> None:
    head, rng = face(), np.random.default_rng(0)
    browed = hair.painted(head, hair.brows(landmarks(), rng), BLACK)
    dark = browed.colours[:, 0] < 0.3
    assert dark.sum() > 20
    where = browed.vertices[dark]
    assert (np.abs(where[:, 1] - 0.0215) < 0.012).all() and (np.abs(where[:, 0]) < 0.06).all()
    assert (where[:, 2] > CENTRE[2]).all(), "the back of the head has brows"
    bearded = hair.painted(head, hair.beard(landmarks(), rng), BLACK)
    dark = bearded.colours[:, 0] < 0.3
    assert dark.sum() > 100 and (bearded.vertices[dark, 1] < -0.02).all()
    lips = (
        (np.abs(head.vertices[:, 0]) < 0.01)
        & (np.abs(head.vertices[:, 1] + 0.05) < 0.004)
        & (head.vertices[:, 2] > -0.04)
    )
    assert lips.any() and not dark[lips].any()
    assert (head.colours == 0.5).all(), "the head itself was painted"


def test_glasses_stand_before_the_eyes_and_a_cap_over_the_skull() -> None:
    head = face()
    rims = np.concatenate([one.vertices for one in worn.glasses(head)])
    assert np.abs(rims[:, 0]).max() < np.abs(head.vertices[:, 0]).max()
    near = rims[np.abs(rims[:, 2] - rims[:, 2].max()) < 0.01]
    assert near[:, 2].min() > head.eyes[:, 2].max() + head.eye_radius
    for eye in head.eyes:
        assert np.linalg.norm(near[:, :2] - eye[:2], axis=1).min() > 0.01, "a rim crosses the pupil"
    shell, brim = worn.cap(head)
    used = shell.vertices
    assert len(np.unique(shell.triangles)) == len(used), "vertices of the face that it does not cover count as worn"
    radius = np.linalg.norm(used - CENTRE, axis=1)
    np.testing.assert_allclose(radius, 0.09 + worn.CAP_M, atol=0.002)
    assert used[:, 1].min() > 0 and brim.vertices[:, 2].max() > head.vertices[:, 2].max()


def test_a_face_without_a_head_gets_one_of_its_tone() -> None:
    rest = np.full((256, 256, 3), 0.2)
    painted = np.zeros((512, 512, 3))
    painted[100:400, 100:400] = [0.6, 0.4, 0.3]
    whole = whole_skin(painted, rest)
    assert whole.shape == painted.shape
    np.testing.assert_allclose(whole[250, 250], [0.6, 0.4, 0.3])
    np.testing.assert_allclose(whole[10, 10], [0.6, 0.4, 0.3], atol=1e-6)
    assert np.abs(np.diff(whole, axis=0)).max() < 2 / BORDER


def test_coordinates_carried_for_colours_find_the_texture_again() -> None:
    from benchmarks.heads import Skin

    rng = np.random.default_rng(1)
    texture = rng.uniform(size=(32, 32, 3))
    uv = rng.uniform(0.05, 0.95, (40, 2))
    skin = Skin(np.zeros((40, 3)), np.arange(39).reshape(13, 3), uv, texture)
    _, _, colours = skin.dense(0)
    _, _, places = places_of(skin, 2048).dense(0)
    np.testing.assert_allclose(places[:, :2], uv, atol=1 / 2048)
    off = np.abs(np.mod(uv * 32, 1) - 0.5).max(1) > 0.47  # a texel's edge: either neighbour will do
    np.testing.assert_array_equal(at_places(texture, places)[~off], colours[~off])


def test_every_group_has_photos_and_every_name_is_there_once() -> None:
    every = names()
    assert len(set(every)) == len(every) and set(QUICK) <= set(every)
    sitters = {sitting.name: sitting for sitting in SITTINGS}
    assert {who for who, *_ in DEVELOPED} <= set(sitters)
    groups = [group for sitting in SITTINGS for group in sitting.groups]
    groups += [group for who, _, _, more in DEVELOPED for group in (*more, *sitters[who].groups)]
    assert set(groups) == set(GROUPS)
    shapes = [one.sitter.shape for one in SITTINGS if isinstance(one.sitter.shape, int)]
    assert len(set(shapes)) == len(shapes) and all(shape % 3 != 2 for shape in shapes)
