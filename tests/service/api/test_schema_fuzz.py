"""Requests made up from the OpenAPI description: never a 5xx, never an answer of another form than it promises."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from service.jobs.database import WORKERS
from service.jobs.settings import Settings
from tests.service.api.conftest import GOOD, TOY, open_api

pytestmark = pytest.mark.slow


def test_no_request_makes_the_server_fail(tmp_path: Path) -> None:
    import schemathesis
    from hypothesis import HealthCheck, given, settings
    from hypothesis import strategies as st
    from schemathesis.checks import not_a_server_error
    from schemathesis.specs.openapi.checks import content_type_conformance, response_schema_conformance

    with open_api(Settings(data=tmp_path / "data", program=TOY, reserve_mb=1)) as client:
        described = schemathesis.openapi.from_asgi("/openapi.json", client.app, headers={"Host": "localhost"})
        job = client.post("/v1/avatars", files={"image": ("x", GOOD)}).json()["id"]
        with client.app.state.context.engine.begin() as connection:  # type: ignore[attr-defined]
            beat = {"name": "w", "version": "x", "ready": True, "seen_at": 1e11}  # else /readyz says 503, rightly
            connection.execute(sa.insert(WORKERS).values(**beat))
        checks: list[Any] = [not_a_server_error, content_type_conformance, response_schema_conformance]
        asked = 0
        found: Any
        for found in described.get_all_operations():
            operation = found.ok()
            if operation.path == "/v1/avatars/{job}/events":
                continue  # an open stream; tested with the real server

            @settings(
                max_examples=40, deadline=None, database=None, derandomize=True, suppress_health_check=list(HealthCheck)
            )
            @given(case=operation.as_strategy(), known=st.booleans())
            def ask(case: Any, known: bool) -> None:
                nonlocal asked
                if known and "job" in (case.path_parameters or {}) and case.method != "DELETE":
                    case.path_parameters["job"] = job
                case.call_and_validate(
                    session=client, base_url="http://localhost", headers={"Host": "localhost"}, checks=checks
                )
                asked += 1

            ask()
        assert asked >= 100
