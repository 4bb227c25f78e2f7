"""The client: one method for each thing that the service does."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from service.client.download import Download
from service.client.errors import JobExpired, NoSuchJob, UnexpectedAnswer
from service.client.events import Event
from service.client.photos import canonical, idempotency_key, opened, photo_sha256
from service.client.pictures import rendered
from service.client.retry import AGAIN, Retry
from service.client.state import Job, checked_id, share
from service.client.transport import Transport
from service.client.waiting import Follower
from service.errors import UsageError

Progress = Callable[[str, float], None]
"""Called with a stage's name and the share of the work that is done, in [0, 1]."""

class Client:
    """A server of this service. Threads may share one client.

    Args:
        server: its address, for example ``https://avatars.example.org``.
        api_key: where the server wants one.
        retry: when to ask again.
        timeout_s: for connecting, and for each wait for bytes.

    Raises:
        UsageError: address or key cannot be right.
    """

    def __init__(
        self, server: str, *, api_key: str | None = None, retry: Retry | None = None, timeout_s: float = 60.0
    ) -> None:
        self._transport = Transport(server, api_key, retry or Retry(), timeout_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give the connections back."""
        self._transport.close()

    def submit(self, photo: Path | bytes, options: Mapping[str, Any] | None = None, *, key: str | None = None) -> Job:
        """Hand in a photo; a file is streamed, not loaded.

        Args:
            photo: a JPEG, PNG or WebP file, or its bytes.
            options: those of the command line as JSON values; what is left out gets the server's default.
            key: ``Idempotency-Key``: the same key, photo and options are the same job. None derives it from photo
                and options, so handing in twice makes one job.

        Raises:
            UsageError: there is no such file, or the server does not know an option.
            UnreadableInput: the server refuses these bytes.
            Refused, ServerUnreachable, UnexpectedAnswer: see ``service.client.errors``.
        """
        wanted = canonical(options or {})
        headers = {"Idempotency-Key": key or idempotency_key(photo_sha256(photo), wanted)}

        @contextlib.contextmanager
        def body() -> Iterator[Mapping[str, Any]]:
            with opened(photo) as stream:
                yield {
                    "files": {
                        "options": (None, wanted, "application/json"),
                        "image": ("photo", stream, "application/octet-stream"),
                    }
                }

        # 409: an earlier attempt with this key, whose answer was lost, is still being taken in.
        content = self._transport.json("POST", "/v1/avatars", headers=headers, body=body, again={*AGAIN, 409})
        return Job.parse(content)

    def state(self, job_id: str) -> Job:
        """What the server says of a job now.

        Raises:
            NoSuchJob, JobExpired: it is not there, or not any more.
            Refused, ServerUnreachable, UnexpectedAnswer: see ``service.client.errors``.
        """
        return Job.parse(self._transport.json("GET", _path(job_id)))

    def events(self, job_id: str, *, last_event_id: str = "", timeout_s: float | None = None) -> Iterator[Event]:
        """Events of a job until it ends, over broken connections too; the last one is a final ``state``.

        Args:
            job_id: the job.
            last_event_id: go on after this event.
            timeout_s: how long to follow.

        Raises:
            WaitTimedOut: the time is over; the job goes on.
            Refused, ServerUnreachable, UnexpectedAnswer: see ``service.client.errors``.
        """
        return Follower(self._transport, _path(job_id), last_event_id, timeout_s).events()

    def wait(
        self, job_id: str, *, timeout_s: float | None = None, progress: Progress = lambda stage, done: None
    ) -> Job:
        """Wait until a job has succeeded.

        Args:
            job_id: the job.
            timeout_s: how long to wait.
            progress: told whenever the job gets on.

        Raises:
            WaitTimedOut: the time is over; the job goes on.
            UnreadableInput, NoUsableFace: the photo cannot be used; the same classes as in a local run.
            JobFailed: the server failed.
            JobCancelled: somebody cancelled the job.
            Refused, ServerUnreachable, UnexpectedAnswer: see ``service.client.errors``.
        """
        for event in self.events(job_id, timeout_s=timeout_s):
            stage = event.data.get("stage")
            if isinstance(stage, str) and "progress" in event.data:
                progress(stage, share(event.data["progress"]))
        job = self.state(job_id)
        fault = job.fault()
        if fault is not None:
            raise fault
        return job

    def download(
        self, job_id: str, target: Path, *, progress: Callable[[int, int | None], None] = lambda done, total: None
    ) -> str:
        """Fetch the archive of a job: whole and checked under the name ``target``, or not at all.

        A broken download goes on where it stopped, in a later call too. Every file in the archive is checked against
        the sha256 in its manifest.

        Args:
            job_id: the job.
            target: the file to write; one that is there is replaced.
            progress: told of bytes so far and in all (None: unknown).

        Returns:
            sha256 of the archive, hex.

        Raises:
            DownloadFailed: what came does not agree with its checksums.
            OutputFault: the file cannot be written.
            Conflict: the job has not succeeded yet.
            Refused, ServerUnreachable, UnexpectedAnswer: see ``service.client.errors``.
        """
        return Download(self._transport, _path(job_id) + "/archive.zip", target, progress).run()

    def delete(self, job_id: str) -> None:
        """Cancel a job that goes on, erase one that has ended. One that is not there (any more) is left at that.

        Raises:
            Refused, ServerUnreachable, UnexpectedAnswer: see ``service.client.errors``.
        """
        with contextlib.suppress(NoSuchJob, JobExpired):
            self._transport.json("DELETE", _path(job_id))

    cancel = delete

    def render(self, job_id: str, scene: Mapping[str, Any] | None = None, **options: Any) -> bytes:
        """A PNG of a finished avatar under a scene.

        Args:
            job_id: the job that made it.
            scene: JSON values of a scene, see ``docs/render.md``; None for a studio.
            options: ``size`` [width, height], ``view``, ``background``, ``samples``, ``tolerance``.

        Raises:
            UsageError: the scene or an option is not possible; names it.
            NoSuchJob, JobExpired, Conflict: there is no such avatar, or not any more, or not yet.
            Refused, ServerUnreachable, UnexpectedAnswer: see ``service.client.errors``.
        """
        _path(job_id)
        wanted = canonical({"avatar": job_id, **({} if scene is None else {"scene": scene}), **options})
        return rendered(self._transport, wanted)

    def quality(self) -> Mapping[str, Any]:
        """Levels of quality with the times that the server measured on its machine."""
        return self._object("/v1/quality")

    def models(self) -> Mapping[str, Any]:
        """Networks and head models that the server runs, with sha256 and licence."""
        return self._object("/v1/models")

    def ready(self) -> None:
        """Return where the server takes photos.

        Raises:
            ServerBusy: it is starting or draining.
            Refused, ServerUnreachable, UnexpectedAnswer: see ``service.client.errors``.
        """
        self._transport.json("GET", "/readyz")

    def _object(self, path: str) -> Mapping[str, Any]:
        content = self._transport.json("GET", path)
        if not isinstance(content, dict):
            raise UnexpectedAnswer(f"{path} answered with {type(content).__name__} instead of an object")
        return content


def _path(job_id: str) -> str:
    try:
        return f"/v1/avatars/{checked_id(job_id)}"
    except UnexpectedAnswer as error:
        raise UsageError(error.message, field="id") from error
