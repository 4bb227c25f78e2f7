"""Light on eyes and teeth: what lids, brows and lips hide of the sky."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from service.light.environment import illumination
from service.light.formulas import Graphs, with_flesh
from service.light.plan import LightPlan
from service.light.scene import Environment, PointLight, Scene
from service.materials.material import Material
from service.materials.part import MeshPart
from service.render.recess import Arriving, RecessLight, skin_around
from service.render.visibility import Occluders, VisibilityDetail
from tests.service.render.toys import EVEN, LAMP, scene

GRAPHS = Graphs(1)
RADIUS_MM = 12.0
FORWARD = np.array([[0.0, 0.0, 1.0]], np.float32)
POLE = np.array([[0.0, 0.0, RADIUS_MM / 1000]], np.float32)


def ball(radius_mm: float, *, hole_deg: float = 0.0) -> np.ndarray:
    """(N, 3) points on a sphere, without those about +Z."""
    count = int(4 * np.pi * radius_mm**2 / 0.1)
    z = 1 - (2 * np.arange(count) + 1) / count
    around = np.arange(count) * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - z * z)
    points = radius_mm * np.stack([flat * np.cos(around), flat * np.sin(around), z], 1)
    return points[z <= np.cos(np.radians(hole_deg))] if hole_deg else points


def plate(low: tuple[float, float, float], high: tuple[float, float, float]) -> np.ndarray:
    """(N, 3) points on a level rectangle between two corners of the same height, mm."""
    x, z = np.meshgrid(np.arange(low[0], high[0], 0.3), np.arange(low[2], high[2], 0.3))
    return np.stack([x.ravel(), np.full(x.size, low[1]), z.ravel()], 1)


def lit(
    points: np.ndarray, normals: np.ndarray, occluders: np.ndarray, what: Scene | None = None,
    plan: LightPlan | None = None,
) -> Arriving:  # fmt: skip
    what = what or scene(EVEN)
    around = Occluders(np.ascontiguousarray(occluders.T, np.float32), 0.45, GRAPHS)
    made = plan or LightPlan.everything(what)
    light = RecessLight(illumination(what), made, GRAPHS, VisibilityDetail(128), (0.0, 0.0, 1.2))
    found = light.arriving(points, normals, around)
    for values in dataclasses.astuple(found):
        assert np.isfinite(values).all()
    return found


def test_a_brow_hides_the_light_from_above() -> None:
    brow = np.concatenate([ball(RADIUS_MM), plate((-40, 8, 0), (40, 8, 30))])
    above, below = Environment(zenith=(1.0,) * 3), Environment(ground=(1.0,) * 3)
    shares = []
    for sky in (above, below):
        free, under = (lit(POLE, FORWARD, what, scene(sky)).irradiance[0, 0] for what in (ball(RADIUS_MM), brow))
        shares.append(under / free)
    assert shares[0] < 0.35 and shares[1] > 0.97


def test_nothing_reaches_teeth_behind_closed_lips_and_all_is_finite() -> None:
    closed, opened = ball(25.0), ball(25.0, hole_deg=50)
    for what in (scene(EVEN), scene(None, LAMP)):
        inside = [lit(0.5 * POLE, FORWARD, each, what).irradiance.max() for each in (closed, opened)]
        assert inside[0] < 0.02 * inside[1] and inside[1] > 0
    found = lit(POLE, FORWARD, closed)
    assert found.openness[0] < 0.02 and found.mirror[0] < 0.02


def test_an_opening_lets_in_its_form_factor() -> None:
    """sin^2 of its half angle: a disc seen along its axis (Howell's catalogue, B-12)."""
    for half in (30, 50, 70):
        found = lit(np.zeros((1, 3), np.float32), FORWARD, ball(25.0, hole_deg=half)).openness[0]
        assert abs(found - np.sin(np.radians(half)) ** 2) < 0.06


def test_a_lamp_is_hidden_as_the_sky_is() -> None:
    high = PointLight((0.0, 1.0, 0.5), (1.0, 1.0, 1.0), 0.0)
    brow = np.concatenate([ball(RADIUS_MM), plate((-40, 8, 0), (40, 8, 30))])
    free, under = (lit(POLE, FORWARD, what, scene(None, high)) for what in (ball(RADIUS_MM), brow))
    assert free.lamps[0, 0] > 0.99 and under.lamps[0, 0] < 0.01 and under.irradiance.max() < 0.01


def test_flesh_sends_back_no_more_than_it_receives() -> None:
    """In a closed mouth light must not pile up, nor come from nowhere; in the open there is no flesh."""
    nothing, white, grey = (np.full((3, 1), value, np.float32) for value in (0.0, 1.0, 0.5))
    openness = np.array([0, 0.25, 1], np.float32)
    total, sent = with_flesh(np.ones((3, 3), np.float32), openness, white, nothing)
    assert np.isfinite(total).all() and np.isfinite(sent).all() and (total >= 1).all()
    np.testing.assert_allclose(total[:, 2], 1)
    total, _ = with_flesh(np.zeros((3, 3), np.float32), openness, grey, white)
    assert not total[:, 0].any() and not total[:, 2].any() and (total[:, 1] < 0.75).all()


def test_no_skin_near_sends_no_light() -> None:
    """A mean of nothing would be NaN."""
    part = toy("eye_left_ball", 0.0)
    assert not skin_around([part], np.ones((5, 3), np.float32), np.ones((5, 3), np.float32)).any()
    assert not skin_around([part], np.ones((0, 3), np.float32), np.ones((0, 3), np.float32)).any()


def toy(name: str, z: float, **material: Any) -> MeshPart:
    """A square before the toy head."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32) * np.float32(0.03)
    points = corners + np.array([0, 0, z], np.float32)
    surface = Material(name, **{"colour": (0.0,) * 3, "ior": 1.376, "roughness": 0.03, **material})
    uv = np.zeros((4, 2), np.float32)
    return MeshPart(name, points, points, np.array([[0, 1, 2, 3]], np.int32), uv, surface)


def test_effects_that_the_plan_leaves_out_are_not_computed() -> None:
    what = scene(EVEN, LAMP)
    plan = LightPlan.everything(what).without("occlusion").without("shadows", 0)
    found = lit(POLE, FORWARD, ball(25.0), what, plan)
    assert found.openness[0] == found.mirror[0] == found.lamps[0, 0] == 1 and found.irradiance[0, 0] > np.pi * 0.99
