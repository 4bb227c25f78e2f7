"""The part ``options`` of a request: JSON from a stranger, turned into checked options."""

from __future__ import annotations

import json
import math
from dataclasses import fields
from functools import lru_cache
from typing import Any, cast

from pydantic import TypeAdapter, ValidationError

from service.api.problems import ProblemError
from service.options import Options

MAX_BYTES = 16 << 10
_MAX_DEPTH = 8


def parse_options(text: bytes) -> Options:
    """JSON object -> options; names and values are those of the command line.

    Raises:
        ProblemError: it is no JSON object, has a name that is not an option, or a value of the wrong kind.
        UsageError: a value is out of range.
    """
    values = parse_object(text) if text.strip() else {}
    known = {field.name for field in fields(Options)}
    for name in values:
        if name not in known:
            where = f"/{name[:40]}"
            detail = f"there is no option {name[:40]!r}; there are {', '.join(sorted(known))}"
            raise ProblemError("unknown-field", 422, detail, pointer=where)
    try:
        return adapter().validate_python(values)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = "/" + "/".join(str(part) for part in first["loc"])
        raise ProblemError("usage", 422, f"{where[1:]}: {first['msg']}", pointer=where) from error


@lru_cache(maxsize=1)
def adapter() -> TypeAdapter[Options]:
    """Checks kinds of values and describes them for OpenAPI; ``Options`` itself checks the ranges."""
    return TypeAdapter(Options)


def parse_object(text: bytes, code: str = "malformed-options") -> dict[str, Any]:
    """A JSON object without NaN and without deep nesting.

    Raises:
        ProblemError: it is none; with ``code``.
    """
    try:
        values = json.loads(text.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise ProblemError(code, 422, pointer="") from error
    where = "" if not isinstance(values, dict) else _unusable(values, 0)
    if where is not None:
        raise ProblemError(code, 422, pointer=where)
    return cast(dict[str, Any], values)


def _unusable(value: Any, depth: int) -> str | None:
    """Pointer to a number that is not finite or to what is nested too deeply; None where there is none."""
    if depth > _MAX_DEPTH or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for name, item in items:
        where = _unusable(item, depth + 1)
        if where is not None:
            return f"/{str(name)[:40].replace('~', '~0').replace('/', '~1')}{where}"
    return None
