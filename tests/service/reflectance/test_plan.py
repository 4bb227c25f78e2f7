from __future__ import annotations

import pytest

from service.map_registry import MAPS
from service.reflectance.plan import ROLES, STAGES, Plan
from service.runtime.network_registry import REGISTRY


def test_stages_run_after_what_they_need() -> None:
    order = list(STAGES)
    for name, stage in STAGES.items():
        assert all(order.index(need) < order.index(name) for need in stage.needs)


def test_tables_name_no_stage_that_there_is_not() -> None:
    assert {one.needs for one in MAPS} - {None} < set(STAGES)
    assert {one.stage for one in REGISTRY} - {"detect", "read", "compare"} < set(STAGES)


@pytest.mark.parametrize(("asked", "expected"), [
    ([], ()),
    (["texture"], ()),
    (["diffuse_albedo"], ("super_resolution", "diffuse_albedo")),
    (["diffuse_normal"], ("super_resolution", "diffuse_albedo", "diffuse_normal")),
    (["displacement"], ("super_resolution", "diffuse_albedo", "specular_normal", "displacement")),
    (ROLES, tuple(STAGES)),
])  # fmt: skip
def test_what_runs(asked: list[str], expected: tuple[str, ...]) -> None:
    assert Plan.of(asked).stages == expected
    assert Plan.of(asked, super_resolution=False).stages == tuple(s for s in expected if s != "super_resolution")


def test_shares_make_a_whole() -> None:
    assert sum(Plan.of(ROLES).shares().values()) == pytest.approx(1)
    assert Plan.of([]).shares() == {}
