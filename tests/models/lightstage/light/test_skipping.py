"""What the planner leaves out costs no more than it says, on heads of the light stage."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")

from models.lightstage.light.bake import bake  # noqa: E402
from models.lightstage.light.expose import expose  # noqa: E402
from models.lightstage.light.prior import sample_scene  # noqa: E402
from models.lightstage.light.skipping import Subject, error, subjects, trials  # noqa: E402
from models.lightstage.light.survey import survey  # noqa: E402
from service.light.plan import LightPlan, plan  # noqa: E402

pytestmark = [pytest.mark.train, pytest.mark.slow]

SCENES = (3, 5, 11)
"""Earlier estimates were over their bounds in these: the second as planned, the others in single effects, where they
had forgotten the sky's hidden mirror image."""


@lru_cache(maxsize=1)
def people() -> list[Subject]:
    return subjects(range(100, 102), 96, 64)


@pytest.mark.parametrize("number", SCENES)
def test_planned_errors_stay_within_their_bounds(number: int) -> None:
    trial = next(trials(people(), range(number, number + 1), 1.0))
    assert trial.bound <= 1.0
    assert trial.error <= trial.bound


@pytest.mark.parametrize("number", SCENES)
def test_each_omission_alone_stays_within_its_bound(number: int) -> None:
    subject = people()[number % 2]
    scene = expose(subject.maps, subject.geometry, sample_scene(number), subject.window)
    everything = LightPlan.everything(scene)
    whole = bake(subject.maps, subject.geometry, scene, everything, subject.window)
    made = plan(scene, survey(subject.maps, subject.geometry, subject.window), 0.0)
    for d in made.decisions:
        image = bake(subject.maps, subject.geometry, scene, everything.without(d.effect, d.light), subject.window)
        assert error(whole, image, subject.face) <= d.bound, (d.effect, d.light)
    assert np.isfinite(made.bound)
