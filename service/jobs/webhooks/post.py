"""One signed POST, as Standard Webhooks (standardwebhooks.com, version 1) has it."""

from __future__ import annotations

import base64
import hashlib
import hmac
import http.client
import socket
import ssl

from service.jobs.webhooks.address import Target, resolved

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
