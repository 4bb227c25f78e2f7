"""Lips and lids of the head in the box: they touch, part and close, in every identity."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from models.head.crossing import crossing_pairs
from models.head.lids import find_lids
from models.head.lips import Lips, find_lips
from models.head.piercing import groups
from models.head.shoot import look_at
from service.geometry.raster import rasterise
from service.head.files import load_head
from service.head.model import HeadModel

Float = npt.NDArray[np.float64]

GAP_M = 5e-5
"""Largest gap along the lip line, metres."""


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return load_head()


@pytest.fixture(scope="module")
def lips(head: HeadModel) -> Lips:
    regions = dict(zip(head.region_names, head.regions.astype(float), strict=True))
    return find_lips(head.mean.astype(float), head.polygons[head.polygon_part == 0].astype(np.int64), regions)


def activation(head: HeadModel, **units: float) -> Float:
    return np.array([next((v for k, v in units.items() if n in (k, k + "Left", k + "Right")), 0.0)
                     for n in head.expression_names])  # fmt: skip


def identities(head: HeadModel, count: int) -> list[Float]:
    random = np.random.default_rng(11)
    return [np.zeros(len(head.identity)), *(random.normal(size=len(head.identity)) for _ in range(count))]


def gap(head: HeadModel, lips: Lips, vertices: npt.NDArray[np.float32]) -> float:
    """Largest distance in metres of a vertex of either lip's contact row from the polyline of the other's."""
    row, along = vertices[lips.contact].astype(float), head.mean[lips.contact, 0]
    corners = [int(np.argmax(along)), int(np.argmin(along))]
    worst = 0.0
    for own, other in ((lips.upper, ~lips.upper), (~lips.upper, lips.upper)):
        chosen = np.unique(np.r_[np.flatnonzero(other), corners])
        line = row[chosen[np.argsort(along[chosen])]]
        a, step = line[:-1], np.diff(line, axis=0)
        for point in row[own]:
            share = np.clip(((point - a) * step).sum(1) / np.maximum((step**2).sum(1), 1e-18), 0, 1)
            worst = max(worst, float(np.linalg.norm(a + share[:, None] * step - point, axis=1).min()))
    return worst


def test_lips_touch_in_every_identity(head: HeadModel, lips: Lips) -> None:
    for identity in identities(head, 100):
        assert gap(head, lips, head.shape(identity)) < GAP_M


@pytest.mark.parametrize("share", [0.2, 0.6, 1.0])
def test_mouth_close_closes_an_open_jaw(head: HeadModel, lips: Lips, share: float) -> None:
    for identity in identities(head, 10):
        assert gap(head, lips, head.shape(identity, activation(head, jawOpen=share))) > 0.2 * share * 0.02
        assert gap(head, lips, head.shape(identity, activation(head, jawOpen=share, mouthClose=share))) < 2 * GAP_M


def pixels(head: HeadModel, vertices: npt.NDArray[np.float32], centre: Float, pitch_deg: float = 0.0) -> dict[str, int]:
    """Pixels of a fifth of a millimetre that each part shows to a camera in front, turned up or down."""
    angle = np.radians(pitch_deg)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    camera = look_at(0.0, 0.0, 0.0, 1.0, 400, 5000.0)
    moved = (vertices - centre) @ turn.T
    depth = camera.to_camera(moved)[:, 2]
    raster = rasterise(camera.project(moved), depth, head.triangles, 400, 400, perspective=True)
    counts = np.bincount(head.triangle_part[raster.triangle[raster.mask]], minlength=len(head.part_names))
    return dict(zip(head.part_names, counts.tolist(), strict=True))


@pytest.mark.parametrize("pitch", [-25.0, 0.0, 25.0])
def test_a_neutral_mouth_shows_no_teeth(head: HeadModel, pitch: float) -> None:
    mouth = np.array([0.0, -0.068, 0.02])
    for identity in identities(head, 5):
        seen = pixels(head, head.shape(identity), mouth, pitch)
        assert seen["teeth_upper"] == seen["teeth_lower"] == seen["tongue"] == 0
    smile = activation(head, mouthUpperUp=0.7, mouthLowerDown=0.7, mouthSmile=0.8)
    assert pixels(head, head.shape(np.zeros(0), smile), mouth)["teeth_upper"] > 1000


def test_a_blink_covers_the_eye_and_ends_on_the_lower_lid(head: HeadModel) -> None:
    regions = dict(zip(head.region_names, head.regions.astype(float), strict=True))
    quads = head.polygons[head.polygon_part == 0].astype(np.int64)
    lids = find_lids(head.mean.astype(float), quads, regions, "left")
    blink = activation(head, eyeBlink=1.0)
    for identity in identities(head, 20):
        vertices = head.shape(identity, blink)
        ball = vertices[np.unique(head.triangles[head.triangle_part == head.part_names.index("eye_left")])]
        seen = pixels(head, vertices, ball.mean(0).astype(float))
        assert seen["eye_left"] == seen["eye_right"] == 0
        row = vertices[lids.contact].astype(float)
        below = (lids.across @ row - row)[lids.upper, 1]
        assert np.abs(below).max() < 0.0025


def test_lips_do_not_cross(head: HeadModel) -> None:
    surfaces = groups(head)
    for name in ("neutral", *head.expression_names):
        units = {name: 1.0} | ({"jawOpen": 1.0} if name == "mouthClose" else {})
        vertices = head.shape(np.zeros(0), activation(head, **units)).astype(float)
        assert not len(crossing_pairs(vertices, surfaces["lip_upper"], surfaces["lip_lower"])), name
