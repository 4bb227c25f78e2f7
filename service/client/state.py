"""What the server says of a job."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from service.client.errors import JobCancelled, UnexpectedAnswer, failure
from service.client.problem import Problem
from service.errors import AvatarError

State = Literal["queued", "running", "succeeded", "failed", "cancelled", "expired"]
STATES: tuple[State, ...] = ("queued", "running", "succeeded", "failed", "cancelled", "expired")

_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,127}")


@dataclass(frozen=True)
class Job:
    """One job as the server described it at one moment.

    Attributes:
        id: the server's name for it.
        state: where it is in its life.
        stage: the pipeline stage that is running, empty before and after.
        progress: share of the work that is done, in [0, 1].
        created_at, started_at, finished_at, expires_at: RFC 3339 times as the server wrote them, or None.
        error: why it failed, or None.
        warnings: stable codes.
        options: the request with all defaults filled in.
        links: URLs as the server wrote them; the client does not follow them.
    """

    id: str
    state: State
    stage: str = ""
    progress: float = 0.0
    created_at: str | None = None
    started_at: str | None = None
    finished_at: str | None = None
    expires_at: str | None = None
    error: Problem | None = None
    warnings: tuple[str, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    links: Mapping[str, Any] = field(default_factory=dict)

    @property
    def ended(self) -> bool:
        """Whether the state is final."""
        return self.state not in ("queued", "running")

    def fault(self) -> AvatarError | None:
        """The exception that an ended job stands for; None if it succeeded or goes on."""
        if self.state == "failed":
            return failure(self.error or Problem(500, "Failed", detail=f"job {self.id} failed without saying why"))
        if self.state in ("cancelled", "expired"):
            return JobCancelled(f"job {self.id} is {self.state}", state=self.state)
        return None

    @classmethod
    def parse(cls, content: object) -> Job:
        """Read a state object; members that this client does not know are ignored.

        Raises:
            UnexpectedAnswer: not an object, no usable id, or an unknown state.
        """
        if not isinstance(content, Mapping):
            raise UnexpectedAnswer(f"the server sent {type(content).__name__} where the state of a job was expected")
        state = content.get("state")
        if state not in STATES:
            raise UnexpectedAnswer(f"the server says the job is {state!r}; this client knows {', '.join(STATES)}")
        error = content.get("error")
        return cls(
            id=checked_id(content.get("id")),
            state=state,
            stage=_text(content.get("stage")) or "",
            progress=share(content.get("progress")),
            created_at=_text(content.get("created_at")),
            started_at=_text(content.get("started_at")),
            finished_at=_text(content.get("finished_at")),
            expires_at=_text(content.get("expires_at")),
            error=Problem.parse(error, 500) if isinstance(error, Mapping) else None,
            warnings=tuple(map(str, content.get("warnings") or ())),
            options=_mapping(content.get("options")),
            links=_mapping(content.get("links")),
        )


def checked_id(value: object) -> str:
    """The id of a job, fit for a path segment.

    Raises:
        UnexpectedAnswer: it is no text of 1 to 128 letters, digits, ``-`` and ``_``.
    """
    if isinstance(value, str) and _ID.fullmatch(value):
        return value
    raise UnexpectedAnswer(f"{value!r} is no id of a job: letters, digits, - and _ are expected")


def share(value: object) -> float:
    """A share of work in [0, 1]; what is no number counts as 0."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return 0.0
    return min(max(float(value), 0.0), 1.0)


def _text(value: object) -> str | None:
    return value if isinstance(value, str) else None


def _mapping(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}
