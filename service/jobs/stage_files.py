"""Finished stages of a job as files, so that a killed run goes on after the last of them.

DBOS could keep each stage as a step of its own, but writes results into the database, and these have hundreds of MB.

Arrays are npy, the rest is JSON, nothing is pickled::

    32 bytes sha256 of what follows | 8 bytes length of the JSON | JSON | npy | npy | ...

JSON and arrays end at multiples of 64 bytes, so that arrays need not be read: they can be mapped into memory.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import mmap
import os
import secrets
import weakref
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field, fields, is_dataclass
from inspect import isfunction
from pathlib import Path
from types import ModuleType
from typing import IO, Any, BinaryIO, TypeVar, TypeVarTuple, cast, get_args, get_type_hints

import numpy as np

from service.jobs.artifacts import Artifacts, artifact_name
from service.stage_cache import Loaded

FORMAT = "3"
"""Version of the form above; part of the name of a stage's file."""

_ALIGNED = 64
_HASH = 32
_LENGTH = 8
_BLOCK = 1 << 20


class Damaged(Exception):
    """The bytes are not what was packed."""


def kept_types(module: ModuleType) -> dict[str, type]:
    """By name, dataclasses that the functions of a module's namespace return, and those that they hold in turn.

    What the stages of ``service.pipeline`` may hand on thereby follows from their annotations, and a file that names
    anything else is refused.
    """
    found: dict[str, type] = {}
    waiting = [get_type_hints(made).get("return") for made in vars(module).values() if isfunction(made)]
    while waiting:
        hint = waiting.pop()
        waiting += get_args(hint)
        if isinstance(hint, type) and is_dataclass(hint) and found.get(_name(hint)) is not hint:
            found[_name(hint)] = hint
            waiting += get_type_hints(hint).values()
    return found


def _name(kind: type) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


def pack(value: object, kinds: Mapping[str, type], stream: BinaryIO) -> None:
    """Write a value to an empty file, maps in pieces, so that :func:`unpack` gives an equal one, to the last bit.

    A value is a dataclass out of ``kinds`` (:func:`kept_types`), an array without objects, a number, a string, None, or
    a tuple, list or dictionary (with strings as keys) of such; TypeError where it holds something else.
    """
    arrays: list[np.ndarray[Any, Any]] = []
    tree = json.dumps(_plain(value, kinds, arrays)).encode()
    tree += b" " * _gap(_HASH + _LENGTH + len(tree))
    stream.write(bytes(_HASH))
    body = _Hashed(stream)
    body.write(len(tree).to_bytes(_LENGTH, "big") + tree)
    for array in arrays:
        np.lib.format.write_array(cast(Any, body), array, allow_pickle=False)
        body.write(bytes(_gap(array.nbytes)))
    stream.seek(0)
    stream.write(body.digest.digest())


def unpack(stream: IO[bytes], kinds: Mapping[str, type], *, mapped: bool = False) -> Any:
    """The inverse of :func:`pack`; :class:`Damaged` where bytes were changed or cut off, or name an unknown dataclass.

    ``mapped`` leaves the arrays in the file, which has to be one of this machine: they cannot be changed, and their
    pages are no memory of this process, as the system may drop them and read them again.
    """
    expected, digest = stream.read(_HASH), hashlib.sha256()
    while block := stream.read(_BLOCK):
        digest.update(block)
    if digest.digest() != expected:
        raise Damaged("the hash is not that of the content")
    end = stream.tell()
    stream.seek(_HASH)
    tree = json.loads(stream.read(int.from_bytes(stream.read(_LENGTH), "big")))
    arrays = []
    view = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) if mapped else None
    while stream.tell() < end:
        arrays.append(_read(stream) if view is None else _mapped(stream, view))
        stream.seek(_gap(stream.tell()), os.SEEK_CUR)
    try:
        return _rich(tree, kinds, arrays)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise Damaged(f"made by another version ({error})") from error


def _read(stream: IO[bytes]) -> np.ndarray[Any, Any]:
    return np.lib.format.read_array(cast(Any, stream), allow_pickle=False)


def _mapped(stream: IO[bytes], view: mmap.mmap) -> np.ndarray[Any, Any]:
    """The array that begins here, as a view of the file."""
    version = np.lib.format.read_magic(cast(Any, stream))
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, kind = read_header(cast(Any, stream))
    start = stream.tell()
    array = np.ndarray(shape, kind, view, start, order="F" if fortran else "C")
    stream.seek(start + array.nbytes)
    return array


def _gap(end: int) -> int:
    """Bytes from here to the next place where an array may begin."""
    return -end % _ALIGNED


class _Hashed:
    """Writes to a stream and hashes what goes through."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.digest = hashlib.sha256()

    def write(self, data: bytes) -> int:
        """Write bytes, and add them to the digest."""
        self.digest.update(data)
        return self._stream.write(data)


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
    name = _name(type(value))
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


class Digests:
    """Hashes of what stages are given; one that was taken of an object is not taken again while the object lives."""

    def __init__(self) -> None:
        self._taken: dict[int, tuple[weakref.ref[Any], bytes]] = {}

    def __call__(self, value: object) -> bytes:
        """sha256 of a value, equal for equal ones; TypeError where it holds what is no data, for example a function."""
        ref, taken = self._taken.get(id(value), (None, b""))
        if ref is not None and ref() is value:
            return taken
        hashed = hashlib.sha256(type(value).__qualname__.encode())
        if value is None or isinstance(value, bool | int | float | str | bytes | Path):
            hashed.update(value if isinstance(value, bytes) else str(value).encode())
        elif isinstance(value, np.ndarray | np.generic):
            array = np.asarray(value)
            if array.dtype.hasobject:
                raise TypeError("a stage is given an array of objects")
            hashed.update(f"{array.dtype.str} {array.shape}".encode())
            hashed.update(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
        elif isinstance(value, tuple | list):
            hashed.update(b"".join(map(self, value)))
        elif isinstance(value, Mapping):
            hashed.update(b"".join(self(key) + self(item) for key, item in value.items()))
        elif is_dataclass(value):
            hashed.update(b"".join(self(field.name) + self(getattr(value, field.name)) for field in fields(value)))
            self._taken[id(value)] = weakref.ref(value), hashed.digest()
        elif not isinstance(value, Loaded):
            raise TypeError(f"a stage is given a {type(value).__qualname__}, of which it cannot be told what it holds")
        return hashed.digest()


T = TypeVar("T")
Given = TypeVarTuple("Given")

log = logging.getLogger(__name__)


@dataclass
class KeptStages:
    """``service.stage_cache.StageCache`` for one job, or for all that correct one head.

    A stage's file is named by a hash of everything that its result depends on: the program and its data, the photo, the
    options that no correction changes, the name of the stage, and what it is given. It begins with the hash of its
    content, so a torn or changed file is computed again; that is why it need not be flushed to the disk.

    Attributes:
        artifacts: where to.
        job: folder, of one job or of :func:`service.jobs.artifacts.kept_folder`.
        basis: whatever the results depend on, as text.
        kinds: dataclasses that results may hold; see :func:`kept_types`.
        scratch: a folder on this machine for files on their way.
        finished: told the name of each stage that was computed and kept.
        mapped: results stay on the disk and are mapped into memory, which is then not used for what earlier stages
            made; they are the same to the last bit and cannot be changed.
        digest: of what stages are given.
    """

    artifacts: Artifacts
    job: str
    basis: str
    kinds: Mapping[str, type]
    scratch: Path
    finished: Callable[[str], None] = lambda name: None
    _: KW_ONLY
    mapped: bool = False
    digest: Digests = field(default_factory=Digests, init=False)

    def get_or_compute(self, name: str, make: Callable[[*Given], T], *given: *Given) -> T:
        """As :meth:`service.stage_cache.StageCache.get_or_compute`; a stage that cannot be read is computed, one that
        cannot be written is not kept; both are logged.
        """
        key = hashlib.sha256(f"{self.basis}\n{name}\n{self.digest(given).hex()}".encode()).hexdigest()
        address = artifact_name(self.job, f"stage_{name}", key, "bin")
        try:
            return cast(T, self._load(address))
        except FileNotFoundError:
            pass
        except (Damaged, OSError) as error:  # what a store cannot give out now can be made
            log.warning("stage %s is computed again: %s", name, error)
        value = make(*given)
        part = self.scratch / f"{secrets.token_hex(8)}.part"
        try:
            with part.open("wb") as target:
                pack(value, self.kinds, target)
            self.artifacts.put(part, address, durable=False)
        except OSError as error:  # a full disk: the job may still get through
            log.warning("stage %s is not kept: %s", name, error)
            part.unlink(missing_ok=True)
        else:
            self.finished(name)
            if self.mapped:
                with contextlib.suppress(OSError, Damaged):
                    return cast(T, self._load(address))
        return value

    def _load(self, address: str) -> Any:
        """The result in a file; FileNotFoundError, or Damaged as of :func:`service.jobs.stage_files.unpack`."""
        store = self.artifacts
        with store.local(address, self.scratch).open("rb") if self.mapped else store.open(address) as stream:
            return unpack(stream, self.kinds, mapped=self.mapped)
