"""The client: one method for each thing that the service does, and what the server says of a job."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import math
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

from service.client.download import Download
from service.client.errors import (
    JobCancelled,
    JobExpired,
    NoSuchJob,
    Problem,
    UnexpectedAnswer,
    WaitTimedOut,
    failure,
)
from service.client.transport import AGAIN, Transport
from service.errors import AvatarError, UsageError
from service.photo.video import is_video

Progress = Callable[[str, float], None]
"""Called with a stage's name and the share of the work that is done, in [0, 1]."""

State = Literal["queued", "running", "succeeded", "failed", "cancelled", "expired"]
STATES: tuple[State, ...] = ("queued", "running", "succeeded", "failed", "cancelled", "expired")

_ASK_EVERY_S = (0.5, 2.0)
"""Pause between two questions how far a job is, in seconds: first and longest."""

_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,127}")


@dataclass(frozen=True)
class Job:
    """One job as the server described it at one moment; ``content`` is all that it said, also what newer servers know.

    ``stage`` is empty before and after, ``progress`` a share in [0, 1], ``warnings`` are stable codes, and ``options``
    the request with all defaults filled in.
    """

    id: str
    state: State
    stage: str = ""
    progress: float = 0.0
    error: Problem | None = None
    warnings: tuple[str, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    content: Mapping[str, Any] = field(default_factory=dict)

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
        """Read a state object; UnexpectedAnswer where it is none, has no usable id, or an unknown state."""
        if not isinstance(content, Mapping):
            raise UnexpectedAnswer(f"the server sent {type(content).__name__} where the state of a job was expected")
        state, error = content.get("state"), content.get("error")
        if state not in STATES:
            raise UnexpectedAnswer(f"the server says the job is {state!r}; this client knows {', '.join(STATES)}")
        return cls(
            id=checked_id(content.get("id")),
            state=state,
            stage=str(content.get("stage") or ""),
            progress=share(content.get("progress")),
            error=Problem.parse(error, 500) if isinstance(error, Mapping) else None,
            warnings=tuple(map(str, content.get("warnings") or ())),
            options=options if isinstance(options := content.get("options"), Mapping) else {},
            content=content,
        )


class Client:
    """A server of this service. Threads may share one client.

    What most methods raise beside what they name: Refused, ServerUnreachable, UnexpectedAnswer, see
    ``service.client.errors``.

    Args:
        server: its address, for example ``https://avatars.example.org``.
        api_key: where the server wants one.
        attempts: how often one request is made at most.
        patience_s: how long one request is tried again.
        timeout_s: for connecting, and for each wait for bytes.

    Raises:
        UsageError: address or key cannot be right.
    """

    def __init__(
        self, server: str, *, api_key: str | None = None, attempts: int = 8, patience_s: float = 300.0,
        timeout_s: float = 60.0,
    ) -> None:  # fmt: skip
        self._transport = Transport(server, api_key, attempts, patience_s, timeout_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give the connections back."""
        self._transport.http.close()

    def submit(
        self, photo: Path | bytes | Sequence[Path | bytes], options: Mapping[str, Any] | None = None, *,
        key: str | None = None,
    ) -> Job:  # fmt: skip
        """Hand in a photo, or several of one person; files are streamed, not loaded.

        Args:
            photo: a JPEG, PNG, WebP or HEIC file, or its bytes, or a list of such; a video of the same person may be
                among them.
            options: those of the command line as JSON values; what is left out gets the server's default.
            key: ``Idempotency-Key``: the same key, photo and options are the same job. None derives it from photo
                and options, so handing in twice makes one job.

        Raises:
            UsageError: there is no such file, or the server does not know an option.
            UnreadableInput: the server refuses these bytes.
        """
        wanted = canonical(options or {})
        photos = [photo] if isinstance(photo, bytes | Path) else list(photo)
        headers = {"Idempotency-Key": key or idempotency_key("+".join(map(photo_sha256, photos)), wanted)}

        @contextlib.contextmanager
        def body() -> Iterator[Mapping[str, Any]]:
            with contextlib.ExitStack() as held:
                streams = [held.enter_context(_opened(one)) for one in photos]
                images = [
                    ("video" if _is_video(one) else "image", ("photo", stream, "application/octet-stream"))
                    for one, stream in zip(photos, streams, strict=True)
                ]
                yield {"files": [("options", (None, wanted, "application/json")), *images]}

        # 409: an earlier attempt with this key, whose answer was lost, is still being taken in.
        again = {*AGAIN, 409}
        return Job.parse(self._transport.ask("POST", "/v1/avatars", body=body, again=again, headers=headers))

    def state(self, job_id: str) -> Job:
        """What the server says of a job now; NoSuchJob or JobExpired where it is not there, or not any more."""
        return Job.parse(self._transport.ask("GET", _path(job_id)))

    def follow(self, job_id: str, *, timeout_s: float | None = None) -> Iterator[Job]:
        """What the server says of a job, asked again and again until it has ended.

        WaitTimedOut: ``timeout_s`` are over; the job goes on.
        """
        end, (pause, longest) = math.inf if timeout_s is None else time.monotonic() + timeout_s, _ASK_EVERY_S
        while True:
            job = self.state(job_id)
            yield job
            left = end - time.monotonic()
            if job.ended:
                return
            if left <= 0:
                raise WaitTimedOut(f"job {job.id} did not end in time; it goes on at the server")
            time.sleep(min(pause, left))
            pause = min(1.5 * pause, longest)

    def wait(
        self, job_id: str, *, timeout_s: float | None = None, progress: Progress = lambda stage, done: None
    ) -> Job:
        """Wait until a job has succeeded; ``progress`` is told how far it is, each time that the server is asked.

        Raises:
            WaitTimedOut: ``timeout_s`` are over; the job goes on.
            UnreadableInput, NoUsableFace: the photo cannot be used; the same classes as in a local run.
            JobFailed: the server failed.
            JobCancelled: somebody cancelled the job.
        """
        for job in self.follow(job_id, timeout_s=timeout_s):
            progress(job.stage, job.progress)
        if (fault := job.fault()) is not None:
            raise fault
        return job

    def download(
        self, job_id: str, target: Path, *, progress: Callable[[int, int | None], None] = lambda done, total: None
    ) -> str:
        """Fetch the archive of a job: whole and checked under the name ``target``, or not at all; gives its hex sha256.

        A broken download goes on where it stopped, in a later call too. The archive is checked against the sha256 that
        the server states, else by the check sums of the zip. ``progress`` is told of bytes so far and in all (None:
        unknown).

        DownloadFailed: what came is something else. OutputFault: the file cannot be written. Conflict: the job has not
        succeeded yet.
        """
        return Download(self._transport, _path(job_id) + "/archive.zip", target, progress).run()

    def delete(self, job_id: str) -> None:
        """Cancel a job that goes on, erase one that has ended. One that is not there (any more) is left at that."""
        with contextlib.suppress(NoSuchJob, JobExpired):
            self._transport.ask("DELETE", _path(job_id))

    def ready(self) -> None:
        """Return where the server takes photos, and takes them with this key.

        ServerBusy: it is starting or draining. AccessDenied: it knows no such key.
        """
        self._transport.ask("GET", "/readyz")
        with contextlib.suppress(NoSuchJob):  # who has no key is told of readiness, but not that a job is not there
            self._transport.ask("GET", _path("0" * 32))


def canonical(options: Mapping[str, Any]) -> str:
    """Options as JSON text, the same for the same options; UsageError where a value is none of JSON's."""
    try:
        return json.dumps(options, sort_keys=True, separators=(",", ":"), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise UsageError(f"options are no JSON: {error}", field="options") from error


def photo_sha256(photo: Path | bytes) -> str:
    """Hex sha256 of a photo, read in blocks; UsageError where there is no such file."""
    with _opened(photo) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def idempotency_key(photo_digest: str, options: str, *more: str | int) -> str:
    """A key for one photo and its options.

    ``photo_digest`` is of :func:`photo_sha256`, ``options`` of :func:`canonical`, and ``more`` whatever else makes a
    job another job, for example the number of an attempt.
    """
    return hashlib.sha256(json.dumps([photo_digest, options, *more]).encode()).hexdigest()


def _is_video(photo: Path | bytes) -> bool:
    with _opened(photo) as stream:
        return is_video(stream.read(16))


def _opened(photo: Path | bytes) -> io.BufferedReader | io.BytesIO:
    if isinstance(photo, bytes):
        return io.BytesIO(photo)
    try:
        return photo.open("rb")
    except OSError as error:
        raise UsageError(f"cannot read {photo}: {error.strerror}", field="photo") from error


def _path(job_id: str) -> str:
    try:
        return f"/v1/avatars/{checked_id(job_id)}"
    except UnexpectedAnswer as error:
        raise UsageError(error.message, field="id") from error


def checked_id(value: object) -> str:
    """The id of a job, fit for a path segment.

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
