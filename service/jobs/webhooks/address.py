"""Which addresses may be told: those of hosts that the operator has listed, and that lead to where they should."""

from __future__ import annotations

import ipaddress
import re
import socket
from dataclasses import dataclass

from service.errors import UsageError

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
