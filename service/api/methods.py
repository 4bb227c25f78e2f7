"""Which methods an address takes, over all routes: the framework lists those of the first route that fits."""

from __future__ import annotations

import re
from typing import Any

from starlette.routing import Match
from starlette.types import Scope

METHODS = ("GET", "HEAD", "POST", "DELETE")

_STREAM = re.compile(r"/v1/avatars/[^/]+/events\Z")


def allowed_methods(scope: Scope) -> list[str]:
    """Methods that the address of a request takes, over all routes."""
    routes: list[Any] = scope["app"].router.routes
    taken = []
    for method in METHODS:
        asked = {**scope, "method": method}
        if any(route.matches(asked)[0] == Match.FULL for route in routes):
            taken.append(method)
    if "GET" in taken and "HEAD" not in taken and not _STREAM.match(scope["path"]):
        taken.insert(1, "HEAD")
    return taken
