"""The part ``options`` of a request: JSON from a stranger, turned into checked options."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import lru_cache
from typing import Any, cast

from pydantic import TypeAdapter, ValidationError

from service.api.problem_responses import ProblemError
from service.options import Options, parse_face, parse_maps, parse_size, parse_texture_size

MAX_BYTES = 16 << 10
MAX_METADATA = 2 << 10
"""Bytes of the part ``metadata``."""

_MAX_DEPTH = 8


def parse_options(text: bytes) -> Options:
    """JSON object -> options; names and values are those of the command line.

    Raises:
        ProblemError: it is no JSON object, has a name that is not an option, or a value of the wrong kind.
        UsageError: a value is out of range.
    """
    return checked_options(parse_object(text) if text.strip() else {})


def parse_metadata(text: bytes) -> dict[str, Any]:
    """The part ``metadata``: a JSON object of the owner's own, given back with the job and never looked into.

    Raises:
        ProblemError: it is no such object, or larger than ``MAX_METADATA``.
    """
    if len(text) > MAX_METADATA:
        words = f"metadata has {len(text)} bytes; at most {MAX_METADATA} are kept"
        raise ProblemError("usage", 422, words, pointer="/metadata")
    return parse_object(text, "malformed-metadata") if text.strip() else {}


def query_options(pairs: Mapping[str, str]) -> Options:
    """Options from the parameters of an address, written as on the command line; as :func:`parse_options`."""
    return checked_options({name: _from_text(name, text) for name, text in pairs.items()})


def checked_options(values: Mapping[str, Any]) -> Options:
    """JSON values -> options.

    Raises:
        ProblemError: there is no such option, or a value is of the wrong kind.
        UsageError: a value is out of range; in the words of the command line.
    """
    for name in values:
        if name not in NAMES:
            where = f"/{name[:40]}"
            detail = f"there is no option {name[:40]!r}; there are {', '.join(sorted(NAMES))}"
            raise ProblemError("unknown-field", 422, detail, pointer=where)
    try:
        # Options checks kinds as well as ranges, and true is no 1 to it. What it cannot even look at is the adapter's.
        return Options(**{name: _shaped(name, value) for name, value in values.items()})
    except TypeError:
        return _described(values)


def _described(values: Mapping[str, Any]) -> Options:
    try:
        return adapter().validate_python(dict(values))
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = "/" + "/".join(str(part) for part in first["loc"])
        raise ProblemError("usage", 422, f"{where[1:]}: {first['msg']}", pointer=where) from error


def _shaped(name: str, value: Any) -> Any:
    """Words as on the command line, and lists as tuples."""
    if isinstance(value, str) and name in _WORDS:
        return _WORDS[name](value)
    if isinstance(value, list) and name in ("maps", "size", "texture_size"):
        return tuple(value)
    return value


def _from_text(name: str, text: str) -> Any:
    if name in _WORDS:
        return text
    try:
        value = json.loads(text)
    except ValueError:
        return text
    return value if isinstance(value, int | float) and not isinstance(value, bool) else text


NAMES = frozenset(field.name for field in fields(Options))

_WORDS: dict[str, Callable[[str], Any]] = {
    "maps": parse_maps,
    "size": parse_size,
    "texture_size": parse_texture_size,
    "face": parse_face,
}
"""Options that the command line writes in words of their own."""


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
