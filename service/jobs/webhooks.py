"""Telling of the end of a job: signed, only to hosts that the operator lists, again until it arrives.

Each attempt is a workflow of its own in the queue of messages, put there in the transaction that ends the job or by the
attempt before it, with a delay. What is sent is read from the job when it is sent, so an erased job leaves no message.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import contextlib
import hashlib
import hmac
import ipaddress
import json
import logging
import re
import socket
import ssl
from dataclasses import dataclass
from pathlib import Path

from service.errors import UsageError
from service.jobs import telemetry
from service.jobs.database import now
from service.jobs.queue import ATTEMPTS
from service.jobs.settings import Settings
from service.jobs.store import Store
from service.jobs.view import job_json

log = logging.getLogger(__name__)

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
    """The target of a ``webhook_url``, as a stranger sent it; UsageError where it is none, or its host is not listed.

    ``hosts`` is the operator's list, names or ``name:port``, joined by commas; ``private`` allows plain HTTP, as inside
    a network of the operator's own.
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

    UsageError: one of its addresses may not be reached; which one is for the operator to know, not for strangers.
    OSError: the name has no address.
    """
    found = socket.getaddrinfo(where.host, where.port, type=socket.SOCK_STREAM)
    addresses = list(dict.fromkeys(str(entry[4][0]) for entry in found))
    for address in addresses:
        if not may_be_reached(address, private=private):
            log.warning("%s leads to %s, which may not be reached", where.host, address)
            kind = "a private network or the open internet" if private else "the open internet (WEBHOOK_PRIVATE is off)"
            words = f"webhook_url leads to {where.host}, which has an address that may not be reached; it has to be of"
            raise UsageError(f"{words} {kind}", field="webhook_url")
    return addresses[0]


async def expect_reachable(where: Target, *, private: bool) -> None:
    """Refuse a target that may not be reached now, as :func:`resolved`; one without an address may have one later."""
    with contextlib.suppress(OSError):  # TimeoutError is one
        await asyncio.wait_for(asyncio.to_thread(resolved, where, private=private), LOOKUP_S)


def may_be_reached(address: str, *, private: bool) -> bool:
    """Whether an address is of the open internet, or, where ``private`` ones are allowed, of a network inside.

    Of IPv6 only global unicast counts as open (RFC 4291), without its tunnels 6to4 and Teredo: those, and what
    translates or contains an address of IPv4 (``64:ff9b::/96``, ``::a.b.c.d``), could lead anywhere. Neither these nor
    groups (multicast) nor the old site-local addresses are ever reached.
    """
    found = ipaddress.ip_address(address.partition("%")[0])
    if found.is_multicast or found.is_unspecified or any(found in tunnel for tunnel in _TUNNELS):
        return False
    if private and found.is_private:
        return True
    return found.is_global and (found.version == 4 or found in _UNICAST)


_UNICAST = ipaddress.ip_network("2000::/3")
_TUNNELS = (ipaddress.ip_network("2002::/16"), ipaddress.ip_network("2001::/32"))

LOOKUP_S = 3.0
"""Longest time that a request waits for the address of a name."""

DEADLINE_S = 10.0
"""Longest time of one attempt, from the connection to the head of the answer, however many bytes trickle in."""

SENDERS = 16
"""Messages that one worker sends at the same time, each to another host or of another tenant."""


def secret_of(text: bytes) -> bytes:
    """The secret in the text of a file: as Standard Webhooks 1 writes it (``whsec_`` and base64), or the text itself.

    binascii.Error: what follows ``whsec_`` is no base64.
    """
    secret = text.strip()
    coded = secret.removeprefix(b"whsec_")
    return secret if coded == secret else base64.b64decode(coded + b"==")


def signature(secret: bytes, name: str, moment: int, body: bytes) -> str:
    """``v1,`` and the base64 of the HMAC-SHA256 of ``NAME.MOMENT.BODY``, as Standard Webhooks 1 has it.

    The name of a message is the same each time that it is sent; the moment is in seconds since 1970.
    """
    digest = hmac.new(secret, f"{name}.{moment}.".encode() + body, hashlib.sha256).digest()
    return "v1," + base64.b64encode(digest).decode()


def send(where: Target, name: str, moment: int, body: bytes, secret: bytes, *, private: bool) -> int:
    """Send a message; returns the status of the answer, which is not read further. No redirection is followed.

    UsageError: it may not be reached. OSError: there is no way there, time is over, or what answers is no HTTP.
    """
    import httpx  # here only: what takes requests has nothing to fetch with

    address = resolved(where, private=private)
    headers = {
        "Host": f"{where.host}:{where.port}", "Content-Type": "application/json", "User-Agent": "avatarme",
        "webhook-id": name, "webhook-timestamp": str(moment),
        "webhook-signature": signature(secret, name, moment, body),
    }  # fmt: skip
    # To the address that was checked; the certificate has to be that of the host.
    trusted = ssl.create_default_context() if where.scheme == "https" else False
    url = httpx.URL(scheme=where.scheme, host=address, port=where.port, raw_path=where.path.encode())

    async def post() -> int:
        async with (
            asyncio.timeout(DEADLINE_S),
            httpx.AsyncClient(verify=trusted, trust_env=False) as http,
            http.stream("POST", url, content=body, headers=headers, extensions={"sni_hostname": where.host}) as answer,
        ):
            return answer.status_code

    try:
        return asyncio.run(post())
    except (TimeoutError, httpx.HTTPError) as error:
        raise OSError(f"{where.host} does not answer in time, or not by HTTP: {type(error).__name__}") from error


def tell(store: Store, settings: Settings, job: str, attempt: int) -> str:
    """One attempt to tell of the end of a job, the next one queued where it does not arrive; gives what came of it, in
    words.

    A host that is not listed any more, or leads where nothing may be sent, is given up at once; of a job that was
    erased meanwhile nobody is told.
    """
    row = store.get(job)
    if row is None or row["webhook"] is None:
        return "nobody is to be told"
    private, last = settings.webhook_private, attempt >= ATTEMPTS
    try:
        where = target(row["webhook"], settings.webhook_hosts, private=private)
        secret = secret_of(Path(settings.webhook_secret).read_bytes())
        body = json.dumps({"type": "job.ended", "job": job_json(row)}).encode()
        status = send(where, f"msg_{job}", int(now()), body, secret, private=private)
        said = f"status {status}"
    except (OSError, UsageError, binascii.Error) as error:
        status, said = 0, f"{type(error).__name__}: {error}"
        last = last or isinstance(error, UsageError)
    arrived = 200 <= status < 300
    with store.engine.begin() as connection:
        if arrived or last:
            telemetry.count(connection, "webhooks", "arrived" if arrived else "given up")
        else:
            store.queue.put_message(connection, row, attempt + 1)
    if not arrived:
        words = "a webhook did not arrive%s: %s"
        log.warning(words, " and is given up" if last else "", said, extra={"job": job, "attempt": attempt})
    return said
