"""Eyes, teeth and tongue of the head in the box: sizes of a person's, and a smile that shows teeth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from models.head.eyes import RINGS_DEG, SEGMENTS, affine_weights, sphere
from models.head.settle import EYE_RADIUS_M, LIMBUS_DEG, MOVES, SETTLED_RINGS_DEG, eye_weights, settled
from models.head.shoot import look_at
from service.errors import ModelFault
from service.geometry.raster import rasterise
from service.head.files import load_head
from service.head.model import HeadModel


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return load_head()


def part(head: HeadModel, name: str) -> npt.NDArray[np.int64]:
    return np.unique(head.triangles[head.triangle_part == head.part_names.index(name)])


def posed(head: HeadModel, **units: float) -> npt.NDArray[np.float32]:
    """The mean head with units of both sides."""
    weight = [max((v for k, v in units.items() if n in (k, k + "Left", k + "Right")), default=0.0)
              for n in head.expression_names]  # fmt: skip
    return head.shape(np.zeros(0), np.array(weight))


def visible(head: HeadModel, vertices: npt.NDArray[np.float32]) -> dict[str, int]:
    """Pixels (of a third of a millimetre) that each part shows to a camera in front."""
    camera = look_at(0.0, 0.0, 0.0, 1.0, 600, 3000.0)
    depth = camera.to_camera(vertices)[:, 2]
    raster = rasterise(camera.project(vertices), depth, head.triangles, 600, 600, perspective=True)
    counts = np.bincount(head.triangle_part[raster.triangle[raster.mask]], minlength=len(head.part_names))
    return dict(zip(head.part_names, counts.tolist(), strict=True))


def test_eyeballs_and_irises_have_a_persons_size(head: HeadModel) -> None:
    for name in ("eye_left", "eye_right"):
        ball = head.mean[part(head, name)].astype(float)
        centre = 0.5 * (ball.min(0) + ball.max(0))
        np.testing.assert_allclose(np.linalg.norm(ball - centre, axis=1), EYE_RADIUS_M, atol=4e-4)
        limbus = ball[1 + 6 * SEGMENTS : 1 + 7 * SEGMENTS]
        assert 2 * np.linalg.norm((limbus - centre)[:, :2], axis=1).mean() == pytest.approx(0.0117, abs=4e-4)
    assert SETTLED_RINGS_DEG[6] == LIMBUS_DEG


def test_lids_close_over_the_eyeballs(head: HeadModel) -> None:
    """Eyes that are too large shine through closed lids."""
    rest, shut = visible(head, head.mean), visible(head, posed(head, eyeBlink=1.0))
    assert rest["eye_left"] > 500
    assert shut["eye_left"] < 0.05 * rest["eye_left"]


def test_a_smile_shows_the_upper_teeth(head: HeadModel) -> None:
    smile = {"mouthSmile": 0.5, "mouthUpperUp": 0.4, "mouthDimple": 0.4}
    for jaw in (0.1, 0.2):
        seen = visible(head, posed(head, jawOpen=jaw, **smile))
        assert seen["teeth_upper"] > 1000
        assert seen["tongue"] < 0.2 * seen["teeth_upper"]


def test_at_rest_the_mouth_is_shut(head: HeadModel) -> None:
    seen = visible(head, head.mean)
    assert seen["teeth_upper"] + seen["teeth_lower"] + seen["tongue"] < 100


def test_upper_teeth_bite_before_the_lower_ones(head: HeadModel) -> None:
    random = np.random.default_rng(0)
    for _ in range(12):
        v = head.shape(random.normal(size=len(head.identity)))
        upper, lower = ({tuple(np.round(p, 6)): p for p in v[part(head, f"teeth_{r}")]} for r in ("upper", "lower"))
        front = [np.array([p for p in row.values() if abs(p[0]) < 0.004]) for row in (upper, lower)]
        edge_upper = front[0][np.argmin(front[0][:, 1])]
        edge_lower = front[1][np.argmax(front[1][:, 1])]
        assert -0.001 < edge_lower[1] - edge_upper[1] < 0.005
        assert edge_upper[2] > edge_lower[2] - 0.0005


def test_tongue_comes_out_over_the_lower_teeth(head: HeadModel) -> None:
    v = posed(head, jawOpen=0.6, tongueOut=1.0)
    tongue, teeth = v[part(head, "tongue")], v[part(head, "teeth_lower")]
    tip = tongue[np.argmax(tongue[:, 2])]
    assert tip[2] > teeth[:, 2].max()
    assert tip[1] > teeth[np.abs(teeth[:, 0]) < 0.004, 1].max() - 0.004


def test_new_rings_follow_every_affine_motion() -> None:
    """The weights may not know the ball's place; else eyes would drift out of their heads from head to head."""
    random = np.random.default_rng(1)
    old, _ = sphere(RINGS_DEG)
    matrix, shift = random.normal(size=(3, 3)), random.normal(size=3)
    weights = eye_weights(0.0154 * old)
    new, _ = sphere(SETTLED_RINGS_DEG)
    moved = weights @ (0.0154 * old @ matrix + shift)
    np.testing.assert_allclose(moved, EYE_RADIUS_M * new @ matrix + shift, atol=1e-9)


def unsettled(head: HeadModel) -> HeadModel:
    """The head with 31 mm eyeballs and its old rings, and teeth and tongue moved back."""
    mean = head.mean.astype(float).copy()
    old, _ = sphere(RINGS_DEG)
    new, _ = sphere(SETTLED_RINGS_DEG)
    for name in ("eye_left", "eye_right"):
        ball = part(head, name)
        mean[ball] = affine_weights(new, 0.0154 / EYE_RADIUS_M * old) @ mean[ball]
    for name, move in MOVES.items():
        base = np.array([0.0, move.height, 0.0])
        own = part(head, name)
        mean[own] = (mean[own] - base - move.shift) / move.scale + base
    return replace(head, mean=mean.astype(np.float32))


def test_a_head_of_before_is_settled_once_and_keeps_its_skin(head: HeadModel) -> None:
    again = settled(unsettled(head))
    np.testing.assert_allclose(again.mean, head.mean, atol=2e-6)
    for name in ("skin", "lashes"):
        own = part(head, name)
        for basis in ("mean", "identity", "expression"):
            assert np.array_equal(getattr(again, basis)[..., own, :], getattr(head, basis)[..., own, :])
    assert np.array_equal(again.uv, head.uv)
    with pytest.raises(ModelFault, match="settled already"):
        settled(head)
