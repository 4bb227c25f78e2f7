"""The head model in the box: what the other stages take for granted."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from models.head.build import variance_weights
from models.head.chart.measure import overlap_texels
from models.head.embedding import CONTOUR
from models.head.expression import PARTNERS
from service.head.files import load_head
from service.head.model import HeadModel

FLIP = np.array([-1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return load_head()


def part(head: HeadModel, name: str) -> npt.NDArray[np.int64]:
    return np.unique(head.triangles[head.triangle_part == head.part_names.index(name)])


def test_the_52_arkit_names(head: HeadModel) -> None:
    """Apple's list, in any order; a misspelt unit would be silently dead in every renderer."""
    sided = "browDown browOuterUp cheekSquint eyeBlink eyeLookDown eyeLookIn eyeLookOut eyeLookUp eyeSquint eyeWide "
    sided += "mouthDimple mouthFrown mouthLowerDown mouthPress mouthSmile mouthStretch mouthUpperUp noseSneer jaw mouth"
    single = (
        "browInnerUp cheekPuff jawForward jawOpen mouthClose mouthFunnel mouthPucker mouthRollLower mouthRollUpper "
    )
    single += "mouthShrugLower mouthShrugUpper tongueOut"
    wanted = {s + side for s in sided.split() for side in ("Left", "Right")} | set(single.split())
    assert len(wanted) == 52
    assert set(head.expression_names) == wanted


def test_mirror_is_an_involution_that_maps_the_mean_onto_itself(head: HeadModel) -> None:
    np.testing.assert_array_equal(head.mirror[head.mirror], np.arange(len(head.mean)))
    np.testing.assert_allclose(head.mean[head.mirror] * FLIP, head.mean, atol=2e-7)


def test_units_are_mirror_images(head: HeadModel) -> None:
    table = dict(zip(head.expression_names, head.expression, strict=True))
    for name, offset in table.items():
        np.testing.assert_allclose(offset[head.mirror] * FLIP, table[PARTNERS[name]], atol=2e-5, err_msg=name)


def test_components_are_orthogonal_and_ordered(head: HeadModel) -> None:
    """Under the weights of the PCA, up to half precision; else a prior of independent coefficients would be wrong.

    Eyes, teeth and tongue, which had a small part in it, are put in their places afterwards and do not count.
    """
    weight = variance_weights(head) * np.isin(np.arange(len(head.mean)), part(head, "skin"))
    flat = (head.identity.astype(float) * np.sqrt(weight)[None, :, None]).reshape(len(head.identity), -1)
    size = np.linalg.norm(flat, axis=1)
    assert (np.diff(size) < 1e-3 * size[0]).all()
    cosine = (flat / size[:, None]) @ (flat / size[:, None]).T
    assert np.abs(cosine - np.eye(len(cosine))).max() < 0.04


def test_looking_turns_the_eyeball_the_right_way(head: HeadModel) -> None:
    """The pole of the eyeball is its foremost vertex; each unit must move it, and the other eye must rest."""
    table = dict(zip(head.expression_names, head.expression, strict=True))
    for side, out in (("Left", 1.0), ("Right", -1.0)):
        ball = part(head, f"eye_{side.lower()}")
        other = part(head, f"eye_{'right' if side == 'Left' else 'left'}")
        pole = ball[np.argmax(head.mean[ball, 2])]
        for name, direction in (
            ("Up", [0, 1, 0]), ("Down", [0, -1, 0]), ("Out", [out, 0, 0]), ("In", [-out, 0, 0]),
        ):  # fmt: skip
            move = table[f"eyeLook{name}{side}"]
            assert move[pole] @ np.array(direction) > 0.002
            assert np.abs(move[other]).max() < 1e-6


def test_skin_is_a_disc_with_one_rim(head: HeadModel) -> None:
    """The only opening of the skin is the cut through the neck: sockets, nostrils and mouth are closed bags."""
    skin = head.triangles[head.triangle_part == 0]
    sides = np.concatenate([skin[:, [0, 1]], skin[:, [1, 2]], skin[:, [2, 0]]])
    directed = {(int(a), int(b)) for a, b in sides}
    assert len(directed) == len(sides)
    rim = {a: b for a, b in directed if (b, a) not in directed}
    start = next(iter(rim))
    walk = [start]
    while rim[walk[-1]] != start:
        walk.append(rim[walk[-1]])
    assert len(walk) == len(rim)
    assert head.mean[walk, 1].max() < -0.09
    edges = len({frozenset(s) for s in directed})
    assert len(np.unique(skin)) - edges + len(skin) == 1


def test_outward_orientation(head: HeadModel) -> None:
    corner = head.mean[head.triangles].astype(float)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    middle = corner.mean(1)
    cheek = head.region("cheek_left")[head.triangles].mean(1) > 0.5
    assert (normal[cheek, 2] > 0).all()
    for name in ("eye_left", "eye_right"):
        faces = head.triangle_part == head.part_names.index(name)
        assert ((normal[faces] * (middle[faces] - middle[faces].mean(0))).sum(1) > 0).all()


def test_chart_does_not_overlap(head: HeadModel) -> None:
    assert head.uv.min() >= 0
    assert head.uv.max() <= 1
    assert overlap_texels(head, 2048) == 0


def test_chart_is_mirror_symmetric(head: HeadModel) -> None:
    """u <-> 1 - u swaps the sides: every triangle's mirror image in the chart is the chart of its mirror image."""
    table = {}
    for triangle, corners in zip(head.triangles.tolist(), head.triangle_uv.tolist(), strict=True):
        order = np.argsort(triangle)
        table[tuple(np.array(triangle)[order])] = head.uv[np.array(corners)[order]]
    for triangle, corners in zip(head.triangles.tolist(), head.triangle_uv.tolist(), strict=True):
        image = head.mirror[triangle]
        order = np.argsort(image)
        mine = head.uv[np.array(corners)[order]] * [-1, 1] + [1, 0]
        np.testing.assert_allclose(mine, table[tuple(image[order])], atol=1e-6)


def test_landmarks_lie_on_the_skin(head: HeadModel) -> None:
    assert len(head.landmark_triangle) == 468
    inner = head.region("mouth_inner") + head.region("eye_socket")
    for triangles in (head.landmark_triangle, head.contour_triangle.ravel()):
        assert (head.triangle_part[triangles] == 0).all()
        assert (inner[head.triangles[triangles]].max(1) < 1).all()
    assert tuple(head.contour_landmarks) == CONTOUR
    points = (head.mean[head.triangles[head.landmark_triangle]] * head.landmark_barycentric[..., None]).sum(1)
    assert points[33, 0] < -0.03  # outer corner of the subject's right eye
    assert points[263, 0] > 0.03
    assert points[1, 2] > points[:, 2].max() - 0.01  # nose tip
    assert points[152, 1] < points[0, 1] < points[1, 1] < points[168, 1] < points[10, 1]
    assert (head.landmark_spread > 0).all()
    assert head.landmark_spread.max() < 0.02
