"""JSON and words from strangers, turned into checked values."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import orjson

from service.api.problem_responses import HttpProblem
from service.options import Options

MAX_BYTES = 16 << 10
MAX_METADATA = 2 << 10
"""Bytes of the part ``metadata``."""

_MAX_LEVELS = 8

NAMES = frozenset(field.name for field in fields(Options))


def parse_options(text: bytes) -> Options:
    """JSON object -> options; names and values are those of the command line.

    HttpProblem: it is no JSON object, or has a name that is not an option. UsageError: a value is of the wrong kind or
    out of range.
    """
    return checked_options(parse_object(text) if text.strip() else {})


def parse_metadata(text: bytes) -> dict[str, Any]:
    """The part ``metadata``: a JSON object of the owner's own, given back with the job and never looked into.

    HttpProblem: it is no such object, or larger than ``MAX_METADATA``.
    """
    if len(text) > MAX_METADATA:
        words = f"metadata has {len(text)} bytes; at most {MAX_METADATA} are kept"
        raise HttpProblem("usage", 422, words, pointer="/metadata")
    return parse_object(text, "malformed-metadata") if text.strip() else {}


def query_options(pairs: Mapping[str, str]) -> Options:
    """Options from the parameters of an address, written as on the command line; as :func:`parse_options`."""
    return checked_options({name: _from_text(text) for name, text in pairs.items()})


def checked_options(values: Mapping[str, Any]) -> Options:
    """JSON values -> options.

    HttpProblem: there is no such option. UsageError: a value is of the wrong kind or out of range; in the words of the
    command line.
    """
    for name in values:
        if name not in NAMES:
            detail = f"there is no option {name[:40]!r}; there are {', '.join(sorted(NAMES))}"
            raise HttpProblem("unknown-field", 422, detail, pointer=f"/{_escaped(name)}")
    return Options(**values)


def _from_text(text: str) -> Any:
    try:
        value = json.loads(text)
    except ValueError:
        return text
    return value if isinstance(value, int | float) and not isinstance(value, bool) else text


def parse_object(text: bytes, code: str = "malformed-options") -> dict[str, Any]:
    """A JSON object that can be stored and given back: numbers are finite, text is Unicode, nesting is not deep.

    HttpProblem, of ``code``, "malformed-" and what the object is: says what is wrong, and where in the text.
    """
    what = code.removeprefix("malformed-")
    try:
        orjson.loads(text)  # strict, unlike the other, which takes NaN and halves of characters
        values = json.loads(text)  # keeps whole numbers of any size
    except (ValueError, RecursionError) as error:
        raise HttpProblem(code, 422, f"{what} is no JSON of finite numbers and Unicode: {error}", pointer="") from error
    if not isinstance(values, dict):
        raise HttpProblem(code, 422, f"{what} has to be a JSON object", pointer="")
    if _levels(values) > _MAX_LEVELS:
        raise HttpProblem(code, 422, f"{what} is nested more than {_MAX_LEVELS} levels deep", pointer="")
    return values


def _levels(value: Any) -> int:
    """How many objects and lists lie in one another."""
    items = value.values() if isinstance(value, dict) else value if isinstance(value, list) else None
    return 0 if items is None else 1 + max(map(_levels, items), default=0)


def _escaped(name: str) -> str:
    """A name as a part of a JSON pointer (RFC 6901)."""
    return name[:40].replace("~", "~0").replace("/", "~1")
