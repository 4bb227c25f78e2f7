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
from service.machine import variable

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
    """Settings of one server or worker process: the variables of docs/service.md, which says what each one is for.

    Beside these, ``batches`` are shards of batches that one worker computes at the same time (0 for none), and
    ``program`` and ``archive_program`` the modules that compute an avatar, and a picture or a kit of an archive; tests
    put small ones there. UsageError names a value that is not of its kind or out of range, and what would be right.
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

    UsageError: as :class:`Settings`; names the variable where the value is from one.
    """
    variables = {field.name: PREFIX + field.name.upper() for field in fields(Settings)}
    named = {name: value for name, one in variables.items() if (value := variable(one, environment)) is not None}
    given = {name: value for name, value in flags.items() if value is not None}
    try:
        return Settings(**{**named, **given})
    except UsageError as error:
        name = error.extra["field"]
        if name in given or name not in named:
            raise
        words = error.message.replace(name, variables[name], 1)
        raise UsageError(words, field=name) from error
