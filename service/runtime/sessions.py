"""Model files, the libraries that run them, and the memory that they leave: only here onnxruntime and OpenVINO are met.

Every model file is listed in ``data/models/models.json`` with its sha256; a file that is missing or changed is refused
before the runtime sees it.

OpenVINO is installed by default on Linux on x86-64 only.

Memory is given back when it is freed: glibc keeps freed blocks of up to 32 MiB for later ones. The tensors of a network
that takes a whole map are of about that size and come and go by the dozen, and what is kept lies in pieces: measured, a
body of zeta that needs 0.2 GB took 0.6 to 2.2 GB. Within :func:`prompt_release` larger blocks come from the system and
go back to it at once. That costs time for fresh pages, a second for zeta's body, so it is not for networks that run in
many tiles; what those leave behind goes back when they are done, by :func:`release`. Every thread would have a heap of
its own, with its own freed blocks; :func:`few_heaps` has all share ``HEAPS``, which takes a draft a quarter less memory
and no more time.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib.util
import json
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from service.errors import ModelFault, NumericFault, OutOfMemory

CONVERTER = "openvino.tools.ovc"
"""What turns models of other libraries into OpenVINO's, and reports that to its makers."""


@lru_cache(maxsize=1)
def has_openvino() -> bool:
    """Whether OpenVINO is installed."""
    return importlib.util.find_spec("openvino") is not None


@lru_cache(maxsize=1)
def openvino_library() -> Any:
    """OpenVINO, imported at first use.

    Left alone, its import makes up a client id, keeps it in the user's home, and forks a process that reports to its
    makers; a fork beside another thread's matrix product can also hang the program. It does without where its converter
    is missing, which is two thirds of the import, so it is told that it is. This program talks to nobody.
    """
    sys.modules.setdefault(CONVERTER, None)  # type: ignore[arg-type]  # None makes an import fail
    import openvino

    # The first array that becomes a tensor initialises a type under two locks, which two threads would take crosswise.
    openvino.Tensor(np.zeros(1, np.float32))
    return openvino


GLIBC = ctypes.CDLL(None)
"""The C library; onnxruntime and OpenVINO are made for this one only."""

TRIM_THRESHOLD, MMAP_THRESHOLD, ARENA_MAX = -1, -3, -8
"""Parameters of mallopt(3)."""

HEAPS = 1
"""A second one took a standard head some 40 MB more, and no less time."""

SMALL, LARGE = 4 << 20, 32 << 20
"""Bytes from which on blocks go back at once: within :func:`prompt_release`, and afterwards, which is glibc's most."""


_NO_MEMORY = ("bad_alloc", "bad allocation", "Failed to allocate", "out of memory", "ALLOC_FAILED")
"""What onnxruntime and OpenVINO say, in exceptions of types that mean anything."""

_CV_NO_MEMORY = -4
"""Error::StsNoMem of OpenCV."""


@contextmanager
def prompt_release() -> Iterator[None]:
    """Give freed blocks of more than ``SMALL`` bytes back at once."""
    GLIBC.mallopt(MMAP_THRESHOLD, SMALL)
    try:
        yield
    finally:
        _usual_thresholds()
        release()


def few_heaps() -> None:
    """Have threads that are yet to begin share ``HEAPS`` heaps."""
    GLIBC.mallopt(ARENA_MAX, HEAPS)
    _usual_thresholds()


def _usual_thresholds() -> None:
    """A threshold that was set once no longer adapts, nor does the other: both go to what they adapt to."""
    GLIBC.mallopt(MMAP_THRESHOLD, LARGE)
    GLIBC.mallopt(TRIM_THRESHOLD, 2 * LARGE)


def release() -> None:
    """Give what was freed and kept for later back to the system."""
    GLIBC.malloc_trim(0)


def lacked_memory(error: BaseException) -> bool:
    """Whether a library's exception says that it got no memory: only Python and numpy have a type for that."""
    insufficient = type(error).__module__ == "cv2" and getattr(error, "code", 0) == _CV_NO_MEMORY
    return isinstance(error, MemoryError) or insufficient or any(words in str(error) for words in _NO_MEMORY)


MODELS = Path(str(files("service"))) / "data" / "models"
TABLE = "models.json"


class Session:
    """One loaded network.

    Attributes:
        name: the entry in models.json.
        outputs: output names in the order in which ``run`` returns them.
    """

    def __init__(self, name: str, native: Any) -> None:
        self.name = name
        self._native = native
        self.outputs: tuple[str, ...] = tuple(o.name for o in native.get_outputs())

    def run(self, inputs: dict[str, npt.NDArray[Any]]) -> list[npt.NDArray[Any]]:
        """Outputs in the order of ``outputs``.

        Raises:
            ModelFault: the runtime refused the inputs or failed; the cause is kept.
            OutOfMemory: the runtime got no memory.
            NumericFault: an input or output holds NaN or Inf.
        """
        require_finite(self.name, "input", inputs)
        try:
            results = self._native.run(list(self.outputs), inputs)
        except Exception as error:  # the runtime's own exception types are not public
            shapes = {key: tuple(value.shape) for key, value in inputs.items()}
            if lacked_memory(error):
                raise OutOfMemory(f"the network {self.name} got no memory for inputs {shapes}") from error
            raise ModelFault(f"network {self.name} failed on inputs {shapes}: {error}") from error
        require_finite(self.name, "output", dict(zip(self.outputs, results, strict=True)))
        return list(results)


def require_finite(name: str, side: str, arrays: Mapping[str, npt.NDArray[Any]]) -> None:
    """Let a network's named inputs or outputs through where they are numbers.

    Raises:
        NumericFault: one holds NaN or Inf; names the network, the array and how many.
    """
    for key, value in arrays.items():
        # A sum is several times as fast as looking at each value, and finite only where all are.
        if value.dtype.kind != "f" or _sum_is_finite(value):
            continue
        if not np.isfinite(value).all():
            bad = int(value.size - np.isfinite(value).sum())
            raise NumericFault(f"network {name}: {side} {key} has {bad} of {value.size} values that are NaN or Inf")


def _sum_is_finite(values: npt.NDArray[Any]) -> bool:
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(values.sum()))


def model_table(folder: Path = MODELS) -> dict[str, dict[str, Any]]:
    """Entries of models.json by name: file, sha256, bytes, licence, source, opset, inputs, outputs.

    Raises:
        ModelFault: the table is missing or not what it should be.
    """
    try:
        content = json.loads((folder / TABLE).read_text(encoding="utf-8"))
        return {str(entry["name"]): dict(entry) for entry in content["models"]}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ModelFault(f"{folder / TABLE}: the table of models cannot be read ({error})") from error


def checked_bytes(name: str, folder: Path = MODELS) -> bytes:
    """Content of a model file after its size and sha256 were found to be those of models.json.

    Raises:
        ModelFault: unknown name, missing file, or another content; names the file and both hashes.
    """
    table = model_table(folder)
    if name not in table:
        raise ModelFault(f"no model {name!r} in {folder / TABLE}; it lists {', '.join(sorted(table))}")
    path = folder / str(table[name]["file"])
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ModelFault(f"{path}: the model file cannot be read ({error})") from error
    found, expected = hashlib.sha256(data).hexdigest(), str(table[name]["sha256"])
    if found != expected:
        raise ModelFault(f"{path}: sha256 is {found}, models.json says {expected}; reinstall the program's data files")
    return data


def load_session(name: str, threads: int = 2, folder: Path = MODELS, *, in_order: bool = False) -> Session:
    """Check a model file and load it, with ``threads`` compute threads and no memory arena.

    ``in_order`` as in :func:`native_session`.

    Raises:
        ModelFault: as ``checked_bytes``, or the runtime cannot load the graph.
        ValueError: threads < 1.
    """
    if threads < 1:
        raise ValueError(f"threads must be at least 1, not {threads}")
    data = checked_bytes(name, folder)
    return Session(name, native_session(name, data, threads, folder, in_order=in_order))


def native_session(
    name: str,
    data: bytes,
    threads: int,
    folder: Path = MODELS,
    *,
    in_order: bool = False,
) -> Any:
    """Session of onnxruntime for checked bytes, without a memory arena (it would keep the largest input for ever).

    With ``in_order`` nodes run in the order of the file. The runtime's own order begins at the outputs, which in a long
    sum keeps every term alive: five times the memory for light that is scattered (``service.light.formulas``).

    Raises:
        ModelFault: the runtime cannot load the graph.
    """
    ort = _runtime()
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.enable_cpu_mem_arena = False
    options.log_severity_level = 3
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    if in_order:
        options.execution_order = ort.ExecutionOrder.PRIORITY_BASED
    try:
        return ort.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # the runtime's own exception types are not public
        if lacked_memory(error):
            raise OutOfMemory(f"the network {name} got no memory to be loaded") from error
        raise ModelFault(f"{folder / name}: the runtime cannot load this model ({error})") from error


@lru_cache(maxsize=1)
def _runtime() -> Any:
    """onnxruntime, imported at first use (0.1 s).

    Left alone it makes up a device id, keeps a diary of sessions in the user's home and sends it to its makers. It
    looks at this variable while it loads. This program talks to nobody.
    """
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"
    import onnxruntime

    return onnxruntime
