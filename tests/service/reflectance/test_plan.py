from __future__ import annotations

import pytest

from service.reflectance.plan import COST, NEEDS, NETWORKS, ROLES, STAGES, Plan


def test_stages_run_after_what_they_need() -> None:
    for stage, needs in NEEDS.items():
        assert all(STAGES.index(need) < STAGES.index(stage) for need in needs)
    assert set(NEEDS) == set(NETWORKS) == set(COST) == set(STAGES)


@pytest.mark.parametrize(("asked", "expected"), [
    ([], ()),
    (["texture"], ()),
    (["diffuse_albedo"], ("super_resolution", "diffuse_albedo")),
    (["diffuse_normal"], ("super_resolution", "diffuse_albedo", "diffuse_normal")),
    (["displacement"], ("super_resolution", "diffuse_albedo", "specular_normal", "displacement")),
    (ROLES, STAGES),
])  # fmt: skip
def test_what_runs(asked: list[str], expected: tuple[str, ...]) -> None:
    assert Plan.of(asked).stages == expected
    assert Plan.of(asked, super_resolution=False).stages == tuple(s for s in expected if s != "super_resolution")


def test_shares_make_a_whole() -> None:
    assert sum(Plan.of(ROLES).shares().values()) == pytest.approx(1)
    assert Plan.of([]).shares() == {}
