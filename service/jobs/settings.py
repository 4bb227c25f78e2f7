"""How a server is set up: flags of the command line, else ``AVATARME_*`` variables, else the defaults here."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from service.errors import UsageError

PREFIX = "AVATARME_"

_KINDS: dict[str, type] = {"int": int, "float": float, "str": str, "bool": bool, "Path": Path}


@dataclass(frozen=True, kw_only=True)
class Settings:
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
        program: module that computes a job; tests put a small one here.
        render_program: module that renders a picture; likewise.
        export_program: module that makes a kit; likewise.
        batch_program: module that makes a photo of a batch; likewise.
    """

    data: Path = Path("avatarme-data")
    database: str = ""
    artifacts: str = ""
    signed_downloads: bool = False
    worker: str = "solo"
    jobs: int = 1
    batches: int = 0
    look_seconds: float = 2.0
    memory_mb: int = 8192
    job_seconds: float = 1800.0
    niceness: int = 10
    result_hours: float = 24.0
    tombstone_hours: float = 168.0
    max_queued: int = 2000
    reserve_mb: int = 2048
    host: str = "127.0.0.1"
    port: int = 8000
    allowed_hosts: str = ""
    keys: str = ""
    first_key: bool = False
    anybody: bool = False
    max_unfinished: int = 2000
    decode_mb: int = 0
    uploads: int = 64
    connections: int = 512
    renders: int = 1
    render_seconds: float = 120.0
    render_wait_seconds: float = 100.0
    exports: int = 1
    export_seconds: float = 600.0
    header_seconds: float = 10.0
    body_seconds: float = 120.0
    idle_seconds: float = 10.0
    stalled_seconds: float = 60.0
    notice_seconds: float = 1.0
    webhook_hosts: str = ""
    webhook_secret: str = ""
    webhook_private: bool = False
    program: str = "service.jobs.avatar_process"
    render_program: str = "service.jobs.render_process"
    export_program: str = "service.jobs.kit_process"
    batch_program: str = "service.jobs.avatar_process"

    def __post_init__(self) -> None:
        for field in (field for field in fields(self) if field.type == "int" and field.name != "niceness"):
            name, least = field.name, int(field.name in ("jobs", "uploads", "max_queued", "max_unfinished"))
            if getattr(self, name) < least:
                raise UsageError(f"{name} is {getattr(self, name)}; it has to be at least {least}", field=name)
        for name in (field.name for field in fields(self) if field.name.endswith(("_seconds", "_hours"))):
            if not getattr(self, name) > 0:
                raise UsageError(f"{name} is {getattr(self, name)}; it has to be above 0", field=name)
        if not self.worker or not self.worker.replace("-", "").replace("_", "").replace(".", "").isalnum():
            raise UsageError(
                f"worker is {self.worker!r}; letters, digits, '-', '_' and '.' are allowed", field="worker"
            )
        if self.first_key and not self.keys:
            raise UsageError("first_key is on and keys names no file that the key could be in", field="keys")
        if self.webhook_hosts and not Path(self.webhook_secret or "/dev/null").is_file():
            raise UsageError("webhook_hosts needs webhook_secret, the file with the secret", field="webhook_secret")
        if self.database and not self.database.startswith(("postgresql", "sqlite:///")):
            raise UsageError("database has to be a postgresql:// address, or empty for SQLite", field="database")

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
        return json.dumps(asdict(self), default=str)


def from_json(text: str) -> Settings:
    """The inverse of :meth:`Settings.to_json`."""
    values = json.loads(text)
    return Settings(**{**values, "data": Path(values["data"])})


def from_environment(flags: Mapping[str, Any], environment: Mapping[str, str] = os.environ) -> Settings:
    """Settings from flags (None: not given), then the environment, then the defaults.

    Raises:
        UsageError: a value is not of its kind or out of range; names the variable.
    """
    chosen: dict[str, Any] = {}
    for field in fields(Settings):
        variable = PREFIX + field.name.upper()
        if flags.get(field.name) is not None:
            chosen[field.name] = flags[field.name]
        elif variable in environment:
            chosen[field.name] = _value(variable, environment[variable], _KINDS[str(field.type)])
    return Settings(**chosen)


def _value(variable: str, text: str, kind: type) -> Any:
    from pydantic import TypeAdapter, ValidationError

    try:
        return TypeAdapter(kind).validate_python(text)
    except ValidationError as error:
        wanted = "true or false" if kind is bool else "a number"
        raise UsageError(f"{variable} is {text!r}; it has to be {wanted}") from error
