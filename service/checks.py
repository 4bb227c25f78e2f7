"""Classes whose fields pydantic checks, with refusals that name the field, its value and what would be right."""

from __future__ import annotations

import json
import types
from collections.abc import Iterator
from dataclasses import is_dataclass
from typing import Any, ClassVar, Literal, NamedTuple, Union, cast, get_args, get_origin, get_type_hints

from pydantic import ConfigDict, ModelWrapValidatorHandler, ValidationError, model_validator
from pydantic.dataclasses import dataclass

from service.errors import UsageError

CHECKED = ConfigDict(extra="forbid")
"""Of every :class:`Checked`: an unknown name is refused, as by any function."""


UNKNOWN = "unexpected_keyword_argument"
"""What pydantic calls a name that a dataclass does not have."""


class Right(NamedTuple):
    """Metadata of a field's type: what its value has to be, as the end of the sentence "it has to be ..."."""

    words: str


@dataclass(frozen=True, kw_only=True, config=CHECKED)
class Checked:
    """Base of dataclasses that are checked when they are made, from keywords or from the values of a JSON object.

    Derived classes are dataclasses of pydantic too, with ``config=CHECKED``. Their types say what is accepted, with
    ``Strict`` where nothing may be converted; a list is accepted for a tuple. What is not accepted is a
    :class:`UsageError` that names the field, the value and what would be right; a validator may raise one itself where
    it knows better words.
    """

    __pydantic_config__: ClassVar[ConfigDict]

    @model_validator(mode="wrap")
    @classmethod
    def _refuse_in_words(cls, given: Any, check: ModelWrapValidatorHandler[Any]) -> Any:
        try:
            return check(given)
        except ValidationError as error:
            raise _refusal(cls, given, error) from error


def _refusal(kind: type, given: Any, error: ValidationError) -> UsageError:
    """The first fault that pydantic found."""
    hints = get_type_hints(kind, include_extras=True)
    place = error.errors(include_url=False)[0]["loc"]
    if place and is_dataclass(hints.get(str(place[0]))):
        return refused(error, kind)
    values = getattr(given, "kwargs", given) or {}  # of a constructor's arguments, or the values of a JSON object
    name = str(next(iter(place), ""))
    if name not in hints or name not in values:
        known = ", ".join(field for field in hints if not field.startswith("_"))
        return UsageError(f"{kind.__name__} has no {name!r}; it has {known}, each by its name", field=name)
    return UsageError(f"{name} is {shown(values[name])}; it has to be {_right(hints[name])}", field=name)


def refused(error: ValidationError, kind: type, what: str = "") -> UsageError:
    """The first fault that pydantic found in nested values, such as a scene; ``field`` is its place, as in a URL.

    A name that does not exist comes first: it is why another one is missing. ``kind`` is the dataclass of the whole,
    and ``what`` its name, where that is not the first part of the place.
    """
    faults = error.errors(include_url=False)
    fault = next((one for one in faults if one["type"] == UNKNOWN), faults[0])
    place, words = "/".join(map(str, fault["loc"])), fault["msg"].removeprefix("Value error, ")
    before = f"{what}: " * bool(what)
    if fault["type"] == UNKNOWN:
        for part in (part for part in fault["loc"][:-1] if isinstance(part, str)):
            kind = next(_dataclasses_in(get_type_hints(kind)[part]))
        return UsageError(f"{before}there is no {place}; there are {', '.join(get_type_hints(kind))}", field=place)
    if fault["type"] == "json_invalid":
        return UsageError(f"{before}not JSON: {words}", field="")
    value = "" if fault["type"] == "missing" else f" is {shown(fault['input'])}"
    return UsageError(f"{before}{place or 'it'}{value}: {words[:1].lower()}{words[1:]}", field=place)


def _dataclasses_in(hint: Any) -> Iterator[type]:
    """Dataclasses that a field's type names, in tuples and unions too."""
    if is_dataclass(hint):
        yield cast(type, hint)
    for part in get_args(hint):
        yield from _dataclasses_in(part)


def shown(value: object) -> str:
    """A value for a message, as JSON writes it but for text, which has single quotes; at most 60 characters."""
    words = repr(value) if isinstance(value, str) else json.dumps(value, default=repr)
    return words if len(words) <= 60 else f"{words[:57]}..."


def _right(hint: Any) -> str:
    """What a value of this type has to be."""
    words = [note.words for note in getattr(hint, "__metadata__", ()) if isinstance(note, Right)]
    return words[0] if words else f"one of {', '.join(str(choice) for choice in _choices(hint) if choice is not None)}"


def _choices(hint: Any) -> tuple[Any, ...]:
    """Values of a ``Literal``, or of a union of such and None."""
    if get_origin(hint) is Literal:
        return get_args(hint)
    if get_origin(hint) in (Union, types.UnionType):
        return tuple(choice for part in get_args(hint) for choice in _choices(part))
    return (None,)
