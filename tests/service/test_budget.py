"""The budget of time."""

from __future__ import annotations

from pathlib import Path

import pytest

from service import budget
from service.budget import estimate_seconds, measure_speed, within_budget
from service.map_registry import MAP_NAMES, maps_made_by
from service.options import Options
from service.reflectance.reflectance_plan import ReflectancePlan
from service.runtime.networks import Engine
from tests.service.reflectance.toys import toy_folder


@pytest.fixture(autouse=True)
def every_network(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.options.installed", lambda networks: True)


def test_the_measurement_covers_every_network(tmp_path: Path) -> None:
    networks = ReflectancePlan.of(maps_made_by("networks")).networks
    speed = measure_speed(Engine(threads=1, folder=toy_folder(tmp_path)), networks)
    assert set(speed.networks) == set(networks)
    assert {name for name, one in speed.networks.items() if one.tiles is None} == {"zeta_body", "delta_context"}
    costs = [one.seconds for one in speed.networks.values()]
    assert all(value > 0 for value in (*costs, speed.yardstick))
    options = Options(maps=MAP_NAMES)
    assert 0 < estimate_seconds(speed, options, options.plan()) < 1e4


@pytest.mark.parametrize(("limit", "level", "warnings"), [
    (1.0, "draft", ("over-budget",)), (12.0, "draft", ()), (25.0, "standard", ()), (100.0, "reference", ()),
])  # fmt: skip
def test_the_best_level_that_fits(
    limit: float, level: str, warnings: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    times = {"draft": 5.0, "standard": 20.0, "high": 30.0, "reference": 90.0}
    monkeypatch.setattr(budget, "expected", lambda options: times)
    found, told = within_budget(Options(maps=MAP_NAMES, budget=limit))
    assert (found.quality, told) == (level, warnings)
