"""Every fault that a client reports, as one tree, and the problem objects (RFC 9457) that most of them stand for.

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

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from service.errors import AvatarError, NoUsableFace, UnreadableInput, UsageError

_LONGEST_TEXT = 2000
"""Characters of a title or detail that are kept."""


@dataclass(frozen=True)
class Problem:
    """One problem object.

    Attributes:
        status: HTTP status.
        title: what kind of fault, in words.
        type: URI reference of the kind; its last segment is the stable code.
        detail: what was wrong this time.
        extensions: further members, for example the boxes of several faces.
    """

    status: int
    title: str = ""
    type: str = "about:blank"
    detail: str = ""
    extensions: Mapping[str, Any] = field(default_factory=dict)

    @property
    def code(self) -> str:
        """Stable code for machines: the member ``code``, else the last segment of ``type``, else the status."""
        code = self.extensions.get("code")
        if isinstance(code, str) and code:
            return code
        segment = re.split(r"[/#:]", self.type.rstrip("/#"))[-1]
        return segment if segment and self.type != "about:blank" else f"http-{self.status}"

    @property
    def message(self) -> str:
        """A sentence for people."""
        return self.detail or self.title or f"the server answered with status {self.status}"

    @classmethod
    def parse(cls, content: object, status: int) -> Problem:
        """Read a problem object as leniently as RFC 9457, section 3.1, asks: members of a wrong type are ignored.

        ``status`` counts where the object has none of its own.
        """
        if not isinstance(content, Mapping):
            return cls(status)
        texts = {name: content.get(name) for name in ("title", "type", "detail")}
        known = {name: text[:_LONGEST_TEXT] for name, text in texts.items() if isinstance(text, str)}
        own = content.get("status")
        own_status = own if isinstance(own, int) and not isinstance(own, bool) and 100 <= own <= 599 else status
        rest = {str(name): value for name, value in content.items() if name not in (*known, "status", "instance")}
        return cls(own_status, extensions=rest, **known)


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
    401: AccessDenied, 403: AccessDenied, 404: NoSuchJob, 409: Conflict, 410: JobExpired,
    429: ServerBusy, 503: ServerBusy, 507: ServerBusy,
}  # fmt: skip


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
    for kind in (leaf for root in (UnreadableInput, NoUsableFace, UsageError) for leaf in _tree(root)):
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
