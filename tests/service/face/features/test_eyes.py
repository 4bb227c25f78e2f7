"""Lids are brought to the rims of the photo's eyes, and eyes that a fit places beside them are moved onto them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from service.face.features.eyes import LASH_ROOTS, SeenRims, eyes_on_rims, lids_on_rims
from service.face.features.rims import RIMS, bounded_least_squares
from service.geometry.camera import Camera, exp_rotation
from service.head.model import HeadModel
from service.head.regions import SIDES, lid_edges
from tests.service.face.geometry import FOCAL, units
from tests.toyhead import sphere_head

UPPER, LOWER = slice(9, 16), slice(1, 8)


def camera(yaw_deg: float = 0.0, pitch_deg: float = 0.0, roll_deg: float = 0.0) -> Camera:
    y, p, r = np.radians([yaw_deg, pitch_deg, roll_deg])
    rotation = np.diag([1.0, -1.0, -1.0]) @ exp_rotation(np.array([p, y, r]))
    return Camera(1000, 1000, FOCAL, np.array([500.0, 500.0]), rotation, np.array([0.0, 0.0, 1.0]))


def lids(
    head: HeadModel, neutral: np.ndarray, start: np.ndarray, view: Camera, landmarks: np.ndarray,
    exact: Sequence[str] = (),
) -> np.ndarray:  # fmt: skip
    return lids_on_rims(head, neutral, SeenRims(start, view, landmarks, frozenset(exact)))


def opening(head: HeadModel, vertices: np.ndarray, view: Camera, side: str, place: np.ndarray) -> np.ndarray:
    """(2, n) pixel rows of upper and lower edge at pixel columns, of an upright head seen from the front."""
    edges = lid_edges(head, side)
    assert edges is not None
    found = []
    for lid, lowest in ((edges.upper, True), (edges.lower, False)):
        rows = []
        for own in lid:
            pixel = view.project(vertices[own])
            order = np.argsort(pixel[:, 0])
            rows.append(np.interp(place, pixel[order, 0], pixel[order, 1]))
        found.append(np.max(rows, 0) if lowest else np.min(rows, 0))
    return np.stack(found)


def shown(head: HeadModel, vertices: np.ndarray, view: Camera) -> np.ndarray:
    """(468, 2) landmarks of which the eyes' rims are true, read off the mesh, and the others somewhere."""
    landmarks = np.full((468, 2), 500.0)
    for side in SIDES:
        edges = lid_edges(head, side)
        assert edges is not None
        pixel = view.project(vertices[np.concatenate([*edges.upper, *edges.lower])])
        corners = pixel[[pixel[:, 0].argmax(), pixel[:, 0].argmin()]]
        outer, inner = corners if side == "left" else corners[::-1]
        place = outer[0] + (inner[0] - outer[0]) * np.linspace(0, 1, 9)[1:-1]
        upper, lower = opening(head, vertices, view, side, place)
        rim = np.zeros((16, 2))
        rim[0], rim[8] = outer, inner
        rim[LOWER] = np.stack([place, lower], 1)
        rim[UPPER] = np.stack([place, upper - LASH_ROOTS * np.linalg.norm(inner - outer)], 1)[::-1]
        landmarks[list(RIMS[side])] = rim
    return landmarks


@pytest.mark.parametrize("truth", [{}, {"eyeWide": 0.9}, {"eyeBlink": 0.35}, {"eyeSquint": 0.7}, {"eyeBlink": 0.9}])
@pytest.mark.parametrize("start", [{}, {"eyeBlink": 0.3, "eyeWide": 0.1}])
def test_lids_end_where_the_rim_is(head: HeadModel, truth: dict[str, float], start: dict[str, float]) -> None:
    """Whatever the landmark fit had made of them. A wrong sign or a row behind the lid leaves millimetres."""
    view, true = camera(), units(head, **truth)
    found = lids(head, head.mean, units(head, **start), view, shown(head, head.shape(np.zeros(0), true), view))
    assert (found >= 0).all() and (found <= 1).all()
    for side in SIDES:
        middle = view.project(head.mean[head.region(f"eyelid_{side}") > 0.5])[:, 0].mean()
        place = middle + np.linspace(-14, 14, 9)
        theirs, ours = (opening(head, head.shape(np.zeros(0), e), view, side, place) for e in (true, found))
        assert np.abs(theirs - ours).mean() / FOCAL < 0.0006


def test_what_cannot_be_read_changes_nothing(head: HeadModel) -> None:
    """A division by the length of a rim that is a point, logarithms of nothing, and heads seen from behind."""
    before = units(head, eyeBlink=0.2)
    good = shown(head, head.mean, camera())
    point, missing = good.copy(), good.copy()
    point[:] = 500.0
    missing[:] = np.nan
    for landmarks, view in ((point, camera()), (missing, camera()), (good, camera(yaw_deg=80)), (good, camera(180))):
        assert np.array_equal(lids(head, head.mean, before, view, landmarks), before)
    wild = good.copy()
    wild[:, 1] *= 1e6
    found = lids(head, head.mean, before, camera(), wild)
    assert np.isfinite(found).all() and (found >= 0).all() and (found <= 1).all()
    toy = sphere_head(24, 48)
    none = np.zeros(len(toy.expression))
    assert np.array_equal(lids(toy, toy.mean, none, camera(), good), none)
    assert lid_edges(toy, "left") is None


MM = FOCAL * 1e-3
"""Photo pixels of a millimetre at the eyes, about: the camera is a metre away."""


def rims(head: HeadModel, expression: np.ndarray, right_mm: float, up_mm: float, tilt: float = 0.0) -> np.ndarray:
    """(468, 2) landmarks whose rims lie on the edges of the lids, but each moved and turned in the photo."""
    view = camera()
    out = shown(head, head.shape(np.zeros(0), expression), view)
    for side in SIDES:
        own = list(RIMS[side])
        points = out[own]
        points[UPPER, 1] += LASH_ROOTS * np.linalg.norm(points[8] - points[0])
        middle = points.mean(0)
        turn = np.array([[np.cos(tilt), np.sin(tilt)], [-np.sin(tilt), np.cos(tilt)]])
        out[own] = (points - middle) @ turn.T + middle + MM * np.array([right_mm, -up_mm])
    return out


def placed(
    head: HeadModel, start: np.ndarray, view: Camera, landmarks: np.ndarray, exact: Sequence[str] = SIDES
) -> np.ndarray:
    """The mean head with its eyes where one photo has them."""
    return eyes_on_rims(head, head.mean, [SeenRims(start, view, landmarks, frozenset(exact))])


def test_what_was_not_read_or_has_no_lids_stays(head: HeadModel) -> None:
    """A rim that is a point has no direction, and landmarks that are not finite would move the eye out of the head."""
    good, view = rims(head, units(head, eyeWide=0.5), 1.0, 1.0), camera()
    start = np.zeros(len(head.expression))
    assert np.array_equal(placed(head, start, view, good, ()), head.mean)
    for landmarks in (np.full_like(good, 500.0), np.full_like(good, np.nan)):
        assert np.array_equal(placed(head, start, view, landmarks), head.mean)
    wild = good.copy()
    wild[:, 1] *= 1e6
    moved = np.linalg.norm(placed(head, start, view, wild) - head.mean, axis=1)
    assert np.isfinite(moved).all() and moved.max() < 0.01
    toy = sphere_head(24, 48)
    assert np.array_equal(placed(toy, np.zeros(len(toy.expression)), view, good), toy.mean)


def test_bounded_least_squares_is_scipys() -> None:
    """Bounds that hold none, some or all of the unknowns; rows from weak priors to strong measurements."""
    from scipy.optimize import lsq_linear

    rng = np.random.default_rng(0)
    for _ in range(200):
        n = int(rng.integers(1, 12))
        rows = rng.normal(size=(int(rng.integers(0, 20)), n)) * 10 ** rng.uniform(-2, 2)
        matrix = np.vstack([rows, np.diag(10 ** rng.uniform(-1, 2, n))])
        target = rng.normal(size=len(matrix)) * 10 ** rng.uniform(-1, 2)
        low, high = -rng.random(n) - 1e-9, rng.random(n) + 1e-9
        found = bounded_least_squares(matrix, target, low, high)
        assert (found >= low).all() and (found <= high).all()
        np.testing.assert_allclose(found, lsq_linear(matrix, target, (low, high), method="bvls").x, atol=1e-8)
