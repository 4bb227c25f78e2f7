"""The planner on a made-up surface: a smooth dome, without torch."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from service.errors import UsageError
from service.light.environment import spread_directions
from service.light.plan import plan
from service.light.samples import AZIMUTHS, PLACES, RING_MM, SurfaceSamples
from service.light.scene import Environment, PointLight, Response, Scene

GREY = (0.5, 0.5, 0.5)
EVEN = Environment(zenith=GREY, horizon=GREY, ground=GREY)


def dome(specular: float = 0.7, covered: float = 0.0) -> SurfaceSamples:
    """Samples of the front of a sphere of 80 mm; ``covered`` hides all directions below that height."""
    count, places = 200, len(RING_MM)
    all_round = spread_directions(4 * count)
    normal = all_round[all_round[:, 2] > 0.3][:count]
    count = len(normal)
    tangent = np.cross([0.0, 1.0, 0.0], normal)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    d = spread_directions(128)
    visible = (normal @ d.T > 0.0) & (d[:, 1] > covered - 1.0)
    return SurfaceSamples(
        position=np.repeat(0.08 * normal[None], places, 0),
        diffuse_normal=np.repeat(normal[None], places, 0),
        albedo=np.full((places, count, 3), 0.4),
        normal=normal, tangent=tangent, bitangent=np.cross(normal, tangent),
        specular_normal=np.repeat(normal[None], PLACES, 0), specular=np.full(count, specular),
        alpha=np.tile([0.3, 0.5], (count, 1)), share=np.full(count, 0.8), visible=visible.astype(float),
        horizon=np.zeros((PLACES, count, AZIMUTHS)), weight=np.full(count, 1.0 / count),
    )  # fmt: skip


def scene(*lights: PointLight, environment: Environment = EVEN) -> Scene:
    return Scene(environment, lights, response=Response(exposure=1.0))


KEY = PointLight((0.6, 0.5, 1.0), (2.0, 2.0, 2.0))


def test_in_the_dark_nothing_runs() -> None:
    made = plan(scene(dataclasses.replace(KEY, intensity=(0.0, 0.0, 0.0)), environment=Environment()), dome(), 0.0)
    assert not any(d.runs for d in made.decisions if d.effect != "scattering")
    assert made.bound < 0.05


@pytest.mark.parametrize("tolerance", [0.0, 0.3, 1.0, 5.0, 1000.0])
def test_the_sum_of_bounds_stays_within_the_tolerance(tolerance: float) -> None:
    made = plan(scene(KEY), dome(), tolerance)
    assert made.bound <= tolerance
    assert made.tolerance == tolerance


def test_a_greater_tolerance_never_runs_more() -> None:
    counts = [sum(d.runs for d in plan(scene(KEY), dome(), t).decisions) for t in (0.0, 0.5, 2.0, 10.0, 1000.0)]
    assert counts == sorted(counts, reverse=True)
    assert counts[-1] == 0


def test_a_matt_surface_needs_no_highlights_and_a_shiny_one_does() -> None:
    assert plan(scene(KEY), dome(specular=0.7)).runs("specular", 0)
    faint = dataclasses.replace(KEY, intensity=(0.002, 0.002, 0.002))
    assert not plan(scene(faint), dome(specular=0.7)).runs("specular", 0)


def test_what_hides_the_sky_calls_for_occlusion() -> None:
    """Two walls: nothing hidden costs nothing to leave out; half of the sky hidden costs much."""
    free = {d.effect: d.bound for d in plan(scene(), dome()).decisions}
    hidden = {d.effect: d.bound for d in plan(scene(), dome(covered=1.0)).decisions}
    assert free["occlusion"] < 1.5
    assert hidden["occlusion"] > 5.0


def test_what_cannot_be_planned_is_refused() -> None:
    with pytest.raises(UsageError, match="exposure"):
        plan(Scene(EVEN), dome())
    for wrong in (-1.0, float("nan")):
        with pytest.raises(UsageError, match="tolerance"):
            plan(scene(KEY), dome(), wrong)
