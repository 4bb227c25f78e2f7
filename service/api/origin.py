"""Requests that a browser sends for a web page of somebody else.

A form or a script of any page can post multipart/form-data to any address, for which a browser asks nobody first. What
a browser says of where a request comes from decides: ``Sec-Fetch-Site`` (Fetch Metadata, W3C), and where a browser
leaves it out, as over plain HTTP, ``Origin``. Programs send neither and are let in.
"""

from __future__ import annotations

from starlette.datastructures import URL

SAFE = ("GET", "HEAD", "OPTIONS", "TRACE")
"""Methods that change nothing (RFC 9110, section 9.2.1); that no page reads their answers is up to CORS."""

_OWN = ("same-origin", "none")
_PORTS = {"http": 80, "https": 443}


def is_foreign(method: str, site: str, origin: str, host: str) -> bool:
    """Whether a request that changes something was made by a page of another origin.

    Args:
        method: of the request.
        site: its ``Sec-Fetch-Site``, "" without one.
        origin: its ``Origin``, "" without one.
        host: its ``Host``.
    """
    if method in SAFE:
        return False
    if site:
        return site.strip().lower() not in _OWN
    return bool(origin) and not _same(origin, host)


def _same(origin: str, host: str) -> bool:
    """Whether an origin names the host that was asked; the scheme is the proxy's affair."""
    try:
        theirs = URL(origin.strip().lower())
        ours = URL(f"{theirs.scheme}://{host.strip().lower()}")
        port = _PORTS.get(theirs.scheme)
        if theirs.hostname is None or port is None:
            return False
        return theirs.hostname == ours.hostname and (theirs.port or port) == (ours.port or port)
    except ValueError:
        return False
