"""Results of stages as bytes and back: arrays as npy, the rest as JSON, never pickle.

::

    32 bytes sha256 of what follows | 8 bytes length of the JSON | JSON | npy | npy | ...
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

_HASH = 32
_LENGTH = 8


class Damaged(Exception):
    """The bytes are not what was packed."""


def pack(value: object, kinds: Mapping[str, type]) -> bytes:
    """A value as bytes that :func:`unpack` turns into an equal one, to the last bit.

    Args:
        value: a dataclass out of ``kinds``, an array without objects, a number, a string, None, or a tuple, list or
            dictionary (with strings as keys) of such.
        kinds: dataclasses that may occur, by name.

    Raises:
        TypeError: the value holds something else.
    """
    arrays: list[np.ndarray[Any, Any]] = []
    tree = json.dumps(_plain(value, kinds, arrays)).encode()
    body = io.BytesIO()
    body.write(len(tree).to_bytes(_LENGTH, "big") + tree)
    for array in arrays:
        np.lib.format.write_array(body, array, allow_pickle=False)
    content = body.getbuffer()
    return hashlib.sha256(content).digest() + content


def unpack(data: bytes, kinds: Mapping[str, type]) -> Any:
    """The inverse of :func:`pack`.

    Raises:
        Damaged: the bytes were cut off or changed, or name a dataclass that is not there any more.
    """
    view = memoryview(data)
    if len(data) < _HASH + _LENGTH or hashlib.sha256(view[_HASH:]).digest() != data[:_HASH]:
        raise Damaged("the hash is not that of the content")
    body = io.BytesIO(view[_HASH:])
    tree = json.loads(body.read(int.from_bytes(body.read(_LENGTH), "big")))
    arrays = []
    while body.tell() < len(data) - _HASH:
        arrays.append(np.lib.format.read_array(body, allow_pickle=False))
    try:
        return _rich(tree, kinds, arrays)
    except (KeyError, TypeError, IndexError) as error:
        raise Damaged(f"made by another version ({error})") from error


def _plain(value: object, kinds: Mapping[str, type], arrays: list[np.ndarray[Any, Any]]) -> Any:
    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise TypeError("an array of objects cannot be kept")
        arrays.append(value)
        return {"array": len(arrays) - 1}
    if isinstance(value, np.generic):
        arrays.append(np.asarray(value))
        return {"scalar": len(arrays) - 1}
    if isinstance(value, tuple | list):
        return {type(value).__name__: [_plain(item, kinds, arrays) for item in value]}
    if isinstance(value, Mapping):
        if not all(type(key) is str for key in value):
            raise TypeError("a dictionary that is kept has strings as keys")
        return {"dict": {key: _plain(item, kinds, arrays) for key, item in value.items()}}
    name = type(value).__name__
    if is_dataclass(value) and kinds.get(name) is type(value):
        content = {field.name: _plain(getattr(value, field.name), kinds, arrays) for field in fields(value)}
        return {"class": name, "fields": content}
    raise TypeError(f"a {type(value).__qualname__} cannot be kept")


def _rich(tree: Any, kinds: Mapping[str, type], arrays: list[np.ndarray[Any, Any]]) -> Any:
    if not isinstance(tree, dict):
        return tree
    if "class" in tree:
        return kinds[tree["class"]](**{key: _rich(item, kinds, arrays) for key, item in tree["fields"].items()})
    ((kind, content),) = tree.items()
    if kind == "array":
        return arrays[content]
    if kind == "scalar":
        return arrays[content][()]
    if kind == "dict":
        return {key: _rich(item, kinds, arrays) for key, item in content.items()}
    items = [_rich(item, kinds, arrays) for item in content]
    return tuple(items) if kind == "tuple" else items
