"""Every fault that a client reports, as one tree.

::

    AvatarError
    +-- UnreadableInput, NoUsableFace, UsageError ...   the photo's or the caller's fault: the same classes as locally
    +-- ClientError                                     everything that only a client meets
        +-- ServerUnreachable     no answer after all retries
        +-- UnexpectedAnswer      an answer, but not one of this service
        +-- WaitTimedOut          the caller's time is over; the job goes on
        +-- DownloadFailed        the archive came, but not whole
        +-- JobCancelled          somebody cancelled the job
        +-- JobFailed             the server's fault: a crash, a corrupt model
        +-- Refused               any other 4xx or 5xx
            +-- AccessDenied      401, 403
            +-- NoSuchJob         404
            +-- JobExpired        410
            +-- Conflict          409: asked for too early, or the same key is in flight
            +-- ServerBusy        429, 503, 507 after all retries
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from service.client.problem import Problem
from service.errors import AvatarError, NoUsableFace, UnreadableInput, UsageError


class ClientError(AvatarError):
    code = "client"


class ServerUnreachable(ClientError):
    code = "server-unreachable"


class UnexpectedAnswer(ClientError):
    code = "unexpected-answer"


class WaitTimedOut(ClientError):
    code = "wait-timed-out"


class DownloadFailed(ClientError):
    code = "download-failed"


class JobCancelled(ClientError):
    code = "job-cancelled"


class ProblemError(ClientError):
    """An error with a problem object of the server: ``problem``, None where a program made it up."""

    code = "problem"

    def __init__(self, message: str, *, problem: Problem | None = None, **extra: Any) -> None:
        facts = {} if problem is None else {"status": problem.status, "problem_code": problem.code}
        super().__init__(message, **{**extra, **facts})
        self.problem = problem


class JobFailed(ProblemError):
    code = "job-failed"


class Refused(ProblemError):
    code = "refused"


class AccessDenied(Refused):
    code = "access-denied"


class NoSuchJob(Refused):
    code = "no-such-job"


class JobExpired(Refused):
    code = "job-expired"


class Conflict(Refused):
    code = "conflict"


class ServerBusy(Refused):
    """``retry_after`` is what the last answer asked for, in seconds, None where it did not say."""

    code = "server-busy"
    retry_after: float | None = None


_BY_STATUS: dict[int, type[Refused]] = {
    401: AccessDenied,
    403: AccessDenied,
    404: NoSuchJob,
    409: Conflict,
    410: JobExpired,
    429: ServerBusy,
    503: ServerBusy,
    507: ServerBusy,
}


def refusal(problem: Problem) -> AvatarError:
    """The exception for a request that the server refused."""
    return _fault_of_the_photo(problem) or _BY_STATUS.get(problem.status, Refused)(problem.message, problem=problem)


def failure(problem: Problem) -> AvatarError:
    """The exception for a job that was accepted and then failed."""
    return _fault_of_the_photo(problem) or JobFailed(problem.message, problem=problem)


def error_code(error: AvatarError) -> str:
    """What machines call the fault: the server's code where there is one, else that of the class."""
    return error.problem.code if isinstance(error, ProblemError) and error.problem else error.code


def _fault_of_the_photo(problem: Problem) -> AvatarError | None:
    kinds = (UnreadableInput, NoUsableFace, UsageError)
    for kind in (leaf for root in kinds for leaf in _tree(root)):
        if kind.code == problem.code:
            extra = {name: value for name, value in problem.extensions.items() if name not in ("code", "message")}
            pointer = extra.pop("pointer", None)
            if isinstance(pointer, str) and pointer.startswith("/"):
                extra["field"] = pointer[1:]
            return kind(problem.message, **extra)
    return None


def _tree(root: type[AvatarError]) -> Iterator[type[AvatarError]]:
    yield root
    for branch in root.__subclasses__():
        yield from _tree(branch)
