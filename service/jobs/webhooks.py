"""Telling of the end of a job: signed, only to hosts that the operator lists, again until it arrives."""

from __future__ import annotations

import base64
import hashlib
import hmac
import http.client
import ipaddress
import logging
import re
import socket
import ssl
import threading
from dataclasses import dataclass
from pathlib import Path

import sqlalchemy as sa

from service.errors import UsageError
from service.jobs import telemetry
from service.jobs.database import MESSAGES, now
from service.jobs.settings import Settings

_LONGEST = 2048
_FORM = re.compile(r"(https?)://([a-z0-9.-]{1,253})(?::(\d{1,5}))?(/[!-~]*)?\Z", re.IGNORECASE)
_PORTS = {"https": 443, "http": 80}


@dataclass(frozen=True)
class Target:
    """A checked address.

    Attributes:
        scheme: "https", or "http" where private addresses are allowed.
        host: name, in lower case.
        port: of TCP.
        path: with its query, beginning with "/".
    """

    scheme: str
    host: str
    port: int
    path: str


def target(url: str, hosts: str, *, private: bool) -> Target:
    """The target of a ``webhook_url``.

    Args:
        url: as a stranger sent it.
        hosts: the operator's list, names or ``name:port``, joined by commas.
        private: whether plain HTTP is allowed, as inside a network of the operator's own.

    Raises:
        UsageError: it is no such address, or its host is not listed.
    """
    listed = {name.strip().lower() for name in hosts.split(",") if name.strip()}
    if not listed:
        raise UsageError("this server tells nobody of the end of jobs: it lists no hosts", field="webhook_url")
    match = _FORM.match(url) if len(url) <= _LONGEST else None
    if match is None:
        raise UsageError("webhook_url has to be https://HOST/PATH, without a user and a fragment", field="webhook_url")
    scheme, host = match[1].lower(), match[2].lower()
    port = int(match[3] or _PORTS[scheme])
    if scheme == "http" and not private:
        raise UsageError("webhook_url has to begin with https://", field="webhook_url")
    if f"{host}:{port}" not in listed and not (host in listed and port == _PORTS[scheme]):
        raise UsageError(f"webhook_url leads to {host}:{port}, which this server does not list", field="webhook_url")
    if "#" in (match[4] or ""):
        raise UsageError("webhook_url may have no fragment", field="webhook_url")
    return Target(scheme, host, port, match[4] or "/")


def resolved(where: Target, *, private: bool) -> str:
    """The address of a target to connect to; looked up once, so that what was checked is what is reached.

    Raises:
        OSError: the name has no address, or one that is not of the open internet.
    """
    found = socket.getaddrinfo(where.host, where.port, type=socket.SOCK_STREAM)
    addresses = list(dict.fromkeys(str(entry[4][0]) for entry in found))
    for address in addresses:
        if not private and not ipaddress.ip_address(address.partition("%")[0]).is_global:
            raise OSError(f"{where.host} leads to {address}, which is not of the open internet")
    return addresses[0]


TIMEOUT_S = 10.0
"""For the connection, and for each wait for bytes."""


def signature(secret: bytes, name: str, moment: int, body: bytes) -> str:
    """``v1,`` and the base64 of the HMAC-SHA256 of ``NAME.MOMENT.BODY``.

    Args:
        secret: that the receiver knows too.
        name: of the message, the same each time that it is sent.
        moment: seconds since 1970.
        body: that is sent.
    """
    digest = hmac.new(secret, f"{name}.{moment}.".encode() + body, hashlib.sha256).digest()
    return "v1," + base64.b64encode(digest).decode()


def send(where: Target, name: str, moment: int, body: bytes, secret: bytes, *, private: bool) -> int:
    """Send a message; returns the status of the answer, which is not read further. No redirection is followed.

    Raises:
        OSError: there is no way there, it may not be gone, or what answers is no HTTP.
    """
    connection = _Pinned(where, resolved(where, private=private))
    headers = {
        "Content-Type": "application/json", "User-Agent": "avatarme", "webhook-id": name,
        "webhook-timestamp": str(moment), "webhook-signature": signature(secret, name, moment, body),
    }  # fmt: skip
    try:
        connection.request("POST", where.path, body, headers)
        return connection.getresponse().status
    except http.client.HTTPException as error:
        raise OSError(f"{where.host} does not speak HTTP: {type(error).__name__}") from error
    finally:
        connection.close()


class _Pinned(http.client.HTTPConnection):
    """A connection to one address of a host; the certificate has to be that of the host."""

    def __init__(self, where: Target, address: str) -> None:
        super().__init__(where.host, where.port, timeout=TIMEOUT_S)
        self._where, self._address = where, address

    def connect(self) -> None:
        self.sock = socket.create_connection((self._address, self._where.port), TIMEOUT_S)
        if self._where.scheme == "https":
            self.sock = ssl.create_default_context().wrap_socket(self.sock, server_hostname=self._where.host)


log = logging.getLogger(__name__)

PAUSES_S = (5.0, 30.0, 120.0, 600.0, 1800.0, 3600.0, 7200.0, 14400.0, 28800.0)
"""Between two attempts; 16 hours in all."""

_LEASE_S = 60.0
"""Longest time of one attempt; a worker that dies in it leaves the message to another one after that."""

_AT_ONCE = 20


def deliver(engine: sa.Engine, settings: Settings) -> int:
    """Send what is due; returns how many messages arrived. Several workers may do it at once.

    Args:
        engine: of the database.
        settings: hosts that may be told, and the secret.
    """
    if not settings.webhook_hosts:
        return 0
    secret = Path(settings.webhook_secret).read_bytes().strip()
    due = sa.select(MESSAGES).where(MESSAGES.c.next_at <= now()).order_by(MESSAGES.c.next_at).limit(_AT_ONCE)
    with engine.connect() as connection:
        rows = list(connection.execute(due).mappings())
    return sum(_one(engine, settings, secret, row) for row in rows if _claimed(engine, row))


def _claimed(engine: sa.Engine, row: sa.RowMapping) -> bool:
    """Whether this worker is the one that tries a message now."""
    same = (MESSAGES.c.id == row["id"], MESSAGES.c.next_at == row["next_at"])
    with engine.begin() as connection:
        return bool(connection.execute(sa.update(MESSAGES).where(*same).values(next_at=now() + _LEASE_S)).rowcount)


def _one(engine: sa.Engine, settings: Settings, secret: bytes, row: sa.RowMapping) -> bool:
    facts = {"job": row["job"], "attempt": row["tries"] + 1}
    private = settings.webhook_private
    try:
        where = target(row["url"], settings.webhook_hosts, private=private)
        status = send(where, row["id"], int(now()), row["body"].encode(), secret, private=private)
        said = f"status {status}"
    except (OSError, UsageError) as error:
        status, said = 0, f"{type(error).__name__}: {error}"
    arrived = 200 <= status < 300
    over = arrived or row["tries"] >= len(PAUSES_S)
    with engine.begin() as connection:
        if over:
            connection.execute(sa.delete(MESSAGES).where(MESSAGES.c.id == row["id"]))
            telemetry.count(connection, "webhooks", "arrived" if arrived else "given up")
        else:
            values = {"tries": row["tries"] + 1, "next_at": now() + PAUSES_S[row["tries"]]}
            connection.execute(sa.update(MESSAGES).where(MESSAGES.c.id == row["id"]).values(**values))
    if not arrived:
        log.warning("a webhook did not arrive%s: %s", " and is given up" if over else "", said, extra=facts)
    return arrived


class Teller:
    """Sends what waits, in one thread at a time.

    Args:
        engine: of the database.
        settings: of the worker.
    """

    def __init__(self, engine: sa.Engine, settings: Settings) -> None:
        self._engine, self._settings = engine, settings
        self._thread: threading.Thread | None = None

    def tell(self) -> None:
        """Send what is due, unless that is being done."""
        if self._settings.webhook_hosts and (self._thread is None or not self._thread.is_alive()):
            self._thread = threading.Thread(target=self._send, name="webhooks", daemon=True)
            self._thread.start()

    def _send(self) -> None:
        try:
            deliver(self._engine, self._settings)
        except (sa.exc.SQLAlchemyError, OSError) as error:
            log.warning("webhooks cannot be sent: %s", error)
