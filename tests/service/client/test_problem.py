from __future__ import annotations

import pytest

from service import errors
from service.client.errors import (
    AccessDenied,
    ClientError,
    Conflict,
    JobCancelled,
    JobExpired,
    JobFailed,
    NoSuchJob,
    Refused,
    ServerBusy,
    UnexpectedAnswer,
    error_code,
    failure,
    refusal,
)
from service.client.problem import Problem
from service.client.state import Job, checked_id, share


@pytest.mark.parametrize(
    ("content", "code"),
    [
        ({"type": "/problems/no-face", "code": "other"}, "other"),
        ({"type": "/problems/no-face"}, "no-face"),
        ({"type": "https://example.org/problems#no-face"}, "no-face"),
        ({"type": "urn:problem:no-face/"}, "no-face"),
        ({"type": "about:blank"}, "http-418"),
        ({"type": 5, "title": ["x"], "detail": None, "code": 7}, "http-418"),
        ({}, "http-418"),
        (None, "http-418"),
        (["no-face"], "http-418"),
        ("<html>", "http-418"),
    ],
)
def test_the_code_of_a_problem(content: object, code: str) -> None:
    """Members of a wrong type are ignored (RFC 9457, section 3.1): a broken error must not hide the error."""
    parsed = Problem.parse(content, 418)
    assert parsed.code == code
    assert parsed.message


@pytest.mark.parametrize("status", [True, "404", 7, 10**9, None])
def test_a_status_that_is_none_gives_way_to_that_of_the_answer(status: object) -> None:
    assert Problem.parse({"status": status}, 503).status == 503


def test_the_photo_is_refused_by_the_same_class_as_in_a_local_run() -> None:
    boxes = [[0, 0, 1, 1]]
    error = failure(Problem.parse({"code": "multiple-faces", "detail": "two faces", "boxes": boxes}, 422))
    assert type(error) is errors.MultipleFaces
    assert (error.message, error.extra) == ("two faces", {"boxes": boxes})


def test_the_option_that_was_wrong_is_named() -> None:
    error = refusal(Problem.parse({"code": "usage", "detail": "seed is -1", "pointer": "/seed"}, 422))
    assert type(error) is errors.UsageError
    assert error.extra["field"] == "seed"


@pytest.mark.parametrize(
    ("status", "kind"),
    [
        (401, AccessDenied),
        (403, AccessDenied),
        (404, NoSuchJob),
        (409, Conflict),
        (410, JobExpired),
        (418, Refused),
        (429, ServerBusy),
        (500, Refused),
        (503, ServerBusy),
        (507, ServerBusy),
    ],
)
def test_other_refusals_by_their_status(status: int, kind: type[Refused]) -> None:
    error = refusal(Problem.parse({"code": "whatever", "detail": "words"}, status))
    assert type(error) is kind
    assert error_code(error) == "whatever"
    assert error.exit_status == 1
    assert (error.message, error.extra) == ("words", {"status": status, "problem_code": "whatever"})


def test_a_crash_of_the_server_is_no_fault_of_the_photo() -> None:
    error = failure(Problem.parse({"code": "model-corrupt"}, 500))
    assert type(error) is JobFailed
    assert isinstance(error, ClientError)
    assert error_code(error) == "model-corrupt"


def test_a_state_with_members_of_tomorrow_is_read() -> None:
    job = Job.parse({"id": "a1", "state": "running", "progress": 0.5, "stage": "fit", "new": 1, "warnings": ["w"]})
    assert (job.id, job.progress, job.stage, job.warnings, job.ended) == ("a1", 0.5, "fit", ("w",), False)


@pytest.mark.parametrize(
    "content", [None, [], {"id": "a", "state": "new"}, {"state": "queued"}, {"id": 5, "state": "queued"}]
)
def test_what_is_no_state_is_refused(content: object) -> None:
    with pytest.raises(UnexpectedAnswer):
        Job.parse(content)


@pytest.mark.parametrize("value", ["../x", "a/b", "", "a" * 129, "a?b", "a b", "-a", None, "ä"])
def test_an_id_cannot_lead_elsewhere(value: object) -> None:
    """It becomes a part of the address of the next request, which carries the API key."""
    with pytest.raises(UnexpectedAnswer):
        checked_id(value)


@pytest.mark.parametrize(
    ("value", "expected"), [(0.5, 0.5), (7, 1), (-1, 0), (float("nan"), 0), ("x", 0), (True, 0), (None, 0)]
)
def test_progress_is_a_share_whatever_comes(value: object, expected: float) -> None:
    assert share(value) == expected


@pytest.mark.parametrize("state", ["cancelled", "expired"])
def test_how_a_job_ended(state: str) -> None:
    assert isinstance(Job.parse({"id": "a", "state": state}).fault(), JobCancelled)
    assert Job.parse({"id": "a", "state": "succeeded"}).fault() is None
    silent = Job.parse({"id": "a", "state": "failed", "error": None}).fault()
    assert isinstance(silent, JobFailed), "a server that does not say why has failed all the same"
