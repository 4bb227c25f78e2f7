"""A picture of a finished avatar, from the request to the PNG, however long the server takes for it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

from service.client.answers import picture, picture_or_job
from service.client.state import Job
from service.client.transport import Transport

_LOOK_S = 1.0
"""Seconds between two looks at a picture that takes long."""


def rendered(transport: Transport, wanted: str) -> bytes:
    """The PNG.

    Args:
        transport: to the server.
        wanted: the request as JSON text.

    Raises:
        AvatarError: as :meth:`service.client.client.Client.render`.
    """

    @contextlib.contextmanager
    def body() -> Iterator[Mapping[str, Any]]:
        yield {"content": wanted.encode()}

    headers = {"Content-Type": "application/json"}
    made = transport.answer(picture_or_job, "POST", "/v1/renders", headers=headers, body=body)
    return made if isinstance(made, bytes) else _of_job(transport, Job.parse(made))


def _of_job(transport: Transport, job: Job) -> bytes:
    """The picture of a job that was not ready when the server answered."""
    while not job.ended:
        transport.retry.sleep(_LOOK_S)
        job = Job.parse(transport.json("GET", f"/v1/renders/{job.id}"))
    fault = job.fault()
    if fault is not None:
        raise fault
    return transport.answer(picture, "GET", f"/v1/renders/{job.id}/picture.png")
