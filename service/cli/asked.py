"""From the flags of ``make`` and ``batch`` to options: parsed here, checked in ``service.options``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from service.options import Options, parse_face, parse_maps, parse_size, parse_texture_size, parse_without

_PARSERS: dict[str, Callable[[str], Any]] = {
    "maps": parse_maps,
    "size": parse_size,
    "texture_size": parse_texture_size,
    "face": parse_face,
    "without": parse_without,
}


def asked(**flags: Any) -> dict[str, Any]:
    """Fields of :class:`Options` whose flags were given (are not None).

    Raises:
        UsageError: a value is out of range or cannot be read.
    """
    given = {name: value for name, value in flags.items() if value is not None}
    fields = {name: _PARSERS[name](value) if name in _PARSERS else value for name, value in given.items()}
    Options(**fields)
    return fields


def as_json(fields: dict[str, Any]) -> dict[str, Any]:
    """Fields of :class:`Options` as JSON values."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in fields.items()}
