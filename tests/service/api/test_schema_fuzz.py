"""Requests made up from the OpenAPI description: never a 5xx, never an answer of another form than it promises.

Two tenants ask in turns, by chance for jobs that there are, of their own and of each other, and by chance with text and
numbers that break programs. 5,000 requests:
``AVATARME_FUZZ=5000 pytest -m slow -s -o faulthandler_timeout=0 tests/service/api/test_schema_fuzz.py``.
"""

from __future__ import annotations

import json
import math
import os
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from service.api.keys import new_key
from service.jobs.database import WORKERS
from service.jobs.runner import Runner
from service.jobs.settings import Settings
from tests.service.api.conftest import GOOD, TOY, open_api

CASES = int(os.environ.get("AVATARME_FUZZ", "270"))
"""Requests of a run."""

NASTY: tuple[Any, ...] = (
    "\ud800", "x\udc00y", "\x00", "../../etc/passwd", "9" * 400, 10**400, -(10**400), 2**63, True, [], "",
)  # fmt: skip
"""Values that have broken something somewhere; some are no JSON to a careful reader."""

NOT_JSON = ("NaN", "1e999", '{"a": ', "[" * 5000, '"\\ud83d"')


def spoilt(value: Any, chance: Any) -> Any:
    """A JSON value with one of its parts replaced by a nasty one."""
    if isinstance(value, dict) and value and chance.random() < 0.8:
        name = chance.choice(sorted(value, key=repr))
        return {**value, name: spoilt(value[name], chance)}
    if isinstance(value, dict) and chance.random() < 0.3:
        return {**value, chance.choice(("a", "\ud800", "x" * 300)): chance.choice(NASTY)}
    return chance.choice(NASTY)


def by_hand(client: Any, case: Any, chance: Any, known: dict[str, list[str]], who: dict[str, str]) -> Any:
    """Make a request of the description's likelier to reach something; or make one that no description would.

    Returns:
        The answer to one of those that no description would make, else None.
    """
    for name, value in list((case.path_parameters or {}).items()):
        if name in known and chance.random() < 0.7 and case.method != "DELETE":
            case.path_parameters[name] = chance.choice(known[name])
        elif isinstance(value, str):
            case.path_parameters[name] = value.encode("utf-8", "replace").decode()
    if case.media_type == "application/json" and isinstance(case.body, dict):
        # Of the many parts of a scene one is nearly always impossible; with few of them some requests get through.
        body = {name: value for name, value in case.body.items() if chance.random() < chance.choice((0.2, 1.0))}
        body = {**body, "avatar": chance.choice(known["job"])} if chance.random() < 0.7 else body
        body = spoilt(body, chance) if chance.random() < 0.5 else body
        text = chance.choice(NOT_JSON) if chance.random() < 0.1 else json.dumps(body)
        sent = {**who, "Content-Type": "application/json", "Prefer": "respond-async"}
        return client.post(case.formatted_path, content=text.encode("ascii"), headers=sent)
    if case.media_type == "multipart/form-data" and chance.random() < 0.6:
        name, values = chance.choice((("options", {"seed": 1, "size": [96, 64]}), ("metadata", {"a": {"b": 1}})))
        part = json.dumps(spoilt(values, chance)).encode("ascii")
        return client.post("/v1/avatars", files={"image": ("x", GOOD), name: (None, part)}, headers=who)
    if case.media_type is not None and case.media_type.startswith("image/"):
        case.body = chance.choice((GOOD, GOOD[:-50], b"", case.body))
    return None


@pytest.mark.slow
def test_no_request_makes_the_server_fail(tmp_path: Path) -> None:
    import schemathesis
    from hypothesis import HealthCheck, given, settings
    from hypothesis import strategies as st
    from schemathesis.checks import not_a_server_error
    from schemathesis.specs.openapi.checks import content_type_conformance, response_schema_conformance

    keys = {name: new_key(name) for name in ("ada", "bob")}
    (tmp_path / "keys.json").write_text(json.dumps({"keys": [entry for _, entry in keys.values()]}))
    chosen = Settings(data=tmp_path / "data", program=TOY, reserve_mb=1, keys=str(tmp_path / "keys.json"))
    with open_api(chosen) as client:
        headers = {name: {"Host": "localhost", "Authorization": f"Bearer {key}"} for name, (key, _) in keys.items()}
        described = schemathesis.openapi.from_asgi("/openapi.json", client.app, headers={"Host": "localhost"})
        context: Any = client.app.state.context  # type: ignore[attr-defined]
        known: dict[str, list[str]] = {"job": [], "render": [], "export": []}
        for name in keys:
            for part in ({"keep_photo": (None, "true")}, {}):
                files: Any = {"image": ("x", GOOD), **part}
                known["job"].append(client.post("/v1/avatars", files=files, headers=headers[name]).json()["id"])
        runner = Runner(chosen, context.store, context.artifacts)
        for job in known["job"][::2]:
            assert runner.accept(context.store.get(job)["workflow"])["kind"] == "wanted"
            runner.publish(job, runner.make(job))
        for kind, more in (("render", {}), ("export", {"for": "maya"})):
            for name, job in zip(keys, known["job"][::2], strict=True):
                sent = {**headers[name], "Prefer": "respond-async"}
                known[kind].append(client.post(f"/v1/{kind}s", json={"avatar": job, **more}, headers=sent).json()["id"])
        runner.stop()
        with context.engine.begin() as connection:
            beat = {"name": "w", "version": "x", "ready": True, "seen_at": 1e11}  # else /readyz says 503, rightly
            connection.execute(sa.insert(WORKERS).values(**beat))
        checks: list[Any] = [not_a_server_error, content_type_conformance, response_schema_conformance]
        everything: list[Any] = list(described.get_all_operations())
        operations = [found.ok() for found in everything]
        operations = [one for one in operations if one.path != "/v1/avatars/{job}/events"]  # a stream that stays open
        answers: Counter[tuple[str, int]] = Counter()
        for operation in operations:

            @settings(
                max_examples=math.ceil(CASES / len(operations)), deadline=None, database=None, derandomize=True,
                suppress_health_check=list(HealthCheck),
            )  # fmt: skip
            @given(case=operation.as_strategy(), chance=st.randoms(use_true_random=False))
            def ask(case: Any, chance: Any) -> None:
                who = headers[chance.choice(sorted(keys))]
                answer = by_hand(client, case, chance, known, who)
                if answer is None:
                    answer = case.call_and_validate(
                        session=client, base_url="http://localhost", headers=who, checks=checks
                    )
                assert answer.status_code < 500, answer.text
                answers[f"{case.method} {case.path}", answer.status_code] += 1

            ask()
        for name in keys:
            assert client.get("/v1/avatars?limit=100", headers=headers[name]).status_code == 200
        print(sum(answers.values()), sorted(answers.items()))  # noqa: T201 - for whoever runs it by hand
        assert sum(answers.values()) >= CASES // 2
