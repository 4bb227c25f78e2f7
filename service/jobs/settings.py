"""How a server is set up: flags of the command line, else ``AVATARME_*`` variables, else the defaults here."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Ge, Gt
from pydantic import StringConstraints, TypeAdapter
from pydantic.dataclasses import dataclass

from service.checks import CHECKED, Checked, Right
from service.errors import UsageError

PREFIX = "AVATARME_"

_Flag = Annotated[bool, Right("true or false")]
_Count = Annotated[int, Ge(0), Right("a whole number, at least 0")]
_Several = Annotated[int, Ge(1), Right("a whole number, at least 1")]
_Time = Annotated[float, Gt(0), Right("a number above 0")]
_Name = Annotated[
    str, StringConstraints(pattern=r"^[\w.-]*[^\W_][\w.-]*$"),
    Right("of letters, digits, '-', '_' and '.', with one letter or digit at least"),
]  # fmt: skip
_Hosts = Annotated[
    str, StringConstraints(pattern=r"^(\s*([A-Za-z0-9.-]+(:\d+)?)?\s*(,|$))*$"),
    Right("names of hosts, as hooks.example or hooks.example:8443, joined by commas"),
]  # fmt: skip


@dataclass(frozen=True, kw_only=True, config=CHECKED)
class Settings(Checked):
    """Settings of one server or worker process.

    Attributes:
        data: folder of the database, uploads and results.
        database: SQLAlchemy URL of a Postgres database that several machines share; "" for SQLite in ``data``.
        artifacts: fsspec URL (``s3://bucket/prefix``, ``file:///mnt/shared``) for photos and results; "" for ``data``.
        signed_downloads: send whoever downloads to the store, with an address that holds for five minutes, where the
            store can sign (S3) and everybody reaches it; else this server passes all bytes on.
        worker: name of this worker, different for each one and the same after a restart.
        jobs: photos that one worker computes at the same time, >= 1.
        batches: shards of batches that one worker computes at the same time beside its jobs; 0 for none.
        look_seconds: between two looks of a worker into each of its queues, which are most of what it does beside
            jobs; of all workers of a database, what the one that started last has.
        memory_mb: most memory of one job in MiB, 0 for no limit of ours.
        job_seconds: longest time of one job; many times what it takes, as other work may keep the machine busy.
        niceness: added to the niceness of a job's process, so that answers do not wait for it.
        result_hours: how long a finished job is kept.
        tombstone_hours: how long after that its address says that it is gone.
        max_queued: jobs that may wait, all tenants together.
        reserve_mb: free space in MiB that uploads may not use up and without which no job begins; it has to hold
            the kept stages and the archive of a job.
        host, port: where to listen.
        allowed_hosts: names for the Host header, joined by commas; "" for addresses and the names of this machine.
        keys: path of the file of API keys; "" for a server without keys.
        first_key: make that file with one key where it is missing; the key itself is left beside it, in first-key.txt.
        anybody: serve without keys although others than this machine can reach ``host``.
        max_unfinished: jobs that may be unfinished for one tenant, where its key says nothing else.
        decode_mb: memory in MiB for looking photos through; 0 for what machine or container have but for 512 MiB.
        uploads: uploads that are received at the same time.
        connections: that one address may have open at the same time, 0 for any number; behind a proxy all are its.
        renders: pictures that one worker renders at the same time, each in a process with the limits of a job.
        render_seconds: longest time of one picture.
        render_wait_seconds: how long a request waits for its picture before it is answered with the picture's job.
        exports: kits that one worker makes at the same time, likewise.
        export_seconds: longest time of one kit.
        header_seconds: longest time for the head of a request.
        body_seconds: longest time for the body of a request.
        idle_seconds: longest pause inside the body of a request.
        stalled_seconds: longest time that a reader of an answer may stand still.
        notice_seconds: how long requests are still answered after SIGTERM, ``/readyz`` with 503.
        webhook_hosts: hosts that may be told of the end of a job, joined by commas; "" for none.
        webhook_secret: path of the file with the secret that messages are signed with; needed with ``webhook_hosts``.
        webhook_private: hosts may have addresses of a private network, and be told over plain HTTP.
        program: module that computes an avatar; tests put a small one here.
        archive_program: module that makes a picture or a kit of an archive; likewise.

    Raises:
        UsageError: a value is not of its kind or out of range; names it and what would be right.
    """

    data: Path = Path("avatarme-data")
    database: str = ""
    artifacts: str = ""
    signed_downloads: _Flag = False
    worker: _Name = "solo"
    jobs: _Several = 1
    batches: _Count = 0
    look_seconds: _Time = 2.0
    memory_mb: _Count = 8192
    job_seconds: _Time = 1800.0
    niceness: Annotated[int, Right("a whole number")] = 10
    result_hours: _Time = 24.0
    tombstone_hours: _Time = 168.0
    max_queued: _Several = 2000
    reserve_mb: _Count = 2048
    host: str = "127.0.0.1"
    port: _Count = 8000
    allowed_hosts: str = ""
    keys: str = ""
    first_key: _Flag = False
    anybody: _Flag = False
    max_unfinished: _Several = 2000
    decode_mb: _Count = 0
    uploads: _Several = 64
    connections: _Count = 512
    renders: _Count = 1
    render_seconds: _Time = 120.0
    render_wait_seconds: _Time = 100.0
    exports: _Count = 1
    export_seconds: _Time = 600.0
    header_seconds: _Time = 10.0
    body_seconds: _Time = 120.0
    idle_seconds: _Time = 10.0
    stalled_seconds: _Time = 60.0
    notice_seconds: _Time = 1.0
    webhook_hosts: _Hosts = ""
    webhook_secret: str = ""
    webhook_private: _Flag = False
    program: str = "service.jobs.avatar_process"
    archive_program: str = "service.jobs.archive_process"

    def __post_init__(self) -> None:
        # Said without the value, in which a password may be.
        if self.database and not self.database.startswith(("postgresql", "sqlite:///")):
            raise UsageError("database has to be a postgresql:// address, or empty for SQLite", field="database")
        if self.first_key and not self.keys:
            raise UsageError("first_key is on and keys names no file that the key could be in", field="keys")
        if self.webhook_hosts and not Path(self.webhook_secret or "/dev/null").is_file():
            raise UsageError("webhook_hosts needs webhook_secret, the file with the secret", field="webhook_secret")

    @property
    def database_url(self) -> str:
        """The URL for SQLAlchemy, with the driver that is installed."""
        if self.database.startswith("postgresql://"):
            return "postgresql+psycopg://" + self.database.removeprefix("postgresql://")
        return self.database or f"sqlite:///{self.data.resolve() / 'jobs.sqlite'}"

    @property
    def artifacts_url(self) -> str:
        """The fsspec URL of photos and results."""
        return self.artifacts or f"file://{self.data.resolve() / 'artifacts'}"

    @property
    def incoming(self) -> Path:
        """Folder of uploads that are being received."""
        return self.data / "incoming"

    def to_json(self) -> str:
        """For a process that this one starts; see :func:`from_json`."""
        return TypeAdapter(Settings).dump_json(self).decode()


def from_json(text: str) -> Settings:
    """The inverse of :meth:`Settings.to_json`."""
    return TypeAdapter(Settings).validate_json(text)


def from_environment(flags: Mapping[str, Any], environment: Mapping[str, str] = os.environ) -> Settings:
    """Settings from flags (None: not given), then the environment, then the defaults.

    Raises:
        UsageError: as :class:`Settings`; names the variable where the value is from one.
    """
    variables = {field.name: PREFIX + field.name.upper() for field in fields(Settings)}
    named = {name: environment[variable] for name, variable in variables.items() if variable in environment}
    given = {name: value for name, value in flags.items() if value is not None}
    try:
        return Settings(**{**named, **given})
    except UsageError as error:
        name = error.extra["field"]
        if name in given or name not in named:
            raise
        words = error.message.replace(name, variables[name], 1)
        raise UsageError(words, field=name) from error
