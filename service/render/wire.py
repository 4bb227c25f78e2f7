"""Parse the options of a render from untrusted JSON values."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from service.errors import UsageError
from service.light.scene import Scene
from service.render.request import RenderRequest

_KINDS: dict[str, tuple[type, ...]] = {
    "view": (str, int, float),
    "background": (str,),
    "samples": (int,),
    "tolerance": (int, float),
}

NAMES = tuple(field.name for field in fields(RenderRequest))


def parse(values: Mapping[str, Any]) -> RenderRequest:
    """A request of JSON values; missing or null ones have their defaults.

    Raises:
        UsageError: an unknown field, or a value of the wrong type or out of range; names the field.
    """
    unknown = sorted(set(values) - set(NAMES))
    if unknown:
        raise UsageError(f"there is no field {unknown[0][:40]!r}; there are {', '.join(NAMES)}", field=unknown[0][:40])
    given = {name: value for name, value in values.items() if value is not None}
    if "scene" in given:
        given["scene"] = Scene.from_json(json.dumps(given["scene"]))
    if "size" in given:
        given["size"] = _size(given["size"])
    for name, kinds in _KINDS.items():
        if name in given and (isinstance(given[name], bool) or not isinstance(given[name], kinds)):
            raise UsageError(f"{name} is {given[name]!r:.60}, which is of the wrong type", field=name)
    if "view" in given:
        given["view"] = str(given["view"])
    return RenderRequest(**given)


def _size(value: Any) -> tuple[int, int]:
    whole = isinstance(value, list) and all(isinstance(side, int) and not isinstance(side, bool) for side in value)
    if not whole or len(value) != 2:
        raise UsageError(f"size is {value!r:.60}; it has to be two whole numbers, [width, height]", field="size")
    return value[0], value[1]
