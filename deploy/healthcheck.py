"""Whether the server in this container takes photos: exit status 0 if it does, 1 if not. For HEALTHCHECK of Docker."""

from __future__ import annotations

import http.client
import os
import sys


def healthy(environment: dict[str, str]) -> bool:
    """Ask ``/readyz``.

    Args:
        environment: ``AVATARME_PORT``.
    """
    port = int(environment.get("AVATARME_PORT") or 8000)
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=4)
    try:
        connection.request("GET", "/readyz")
        return connection.getresponse().status == 200
    except (OSError, http.client.HTTPException):
        return False
    finally:
        connection.close()


if __name__ == "__main__":
    sys.exit(0 if healthy(dict(os.environ)) else 1)
