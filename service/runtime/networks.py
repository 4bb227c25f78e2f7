"""Networks that turn maps into maps, behind one seam: onnxruntime always, OpenVINO where it is faster.

OpenVINO computes in bfloat16 on processors that multiply it faster than float32 (AMX, AMD's AVX-512 BF16). In float32
it is ahead of onnxruntime where the processor has AVX-512, and with AVX2 alone for the networks of ``ENLARGING``;
``avatarme bench`` measures that. ``auto`` is a rule made of those measurements and not a measurement at
every start: the runtimes differ in the last bits, and the same photo has to give the same bytes.

A network is loaded when a stage begins and released when it ends, so the memory of a run is that of its largest stage.

OpenVINO compiles a network for a fifth of a second, on one core, and later runs read it from a cache
(``service.runtime.compiled_networks``). Fit and texture use one core too; so the networks of the later stages are made
ready beside them (:func:`loading_ahead`).

What a network takes and how far it looks stands in its ONNX file, as JSON under the key "description": another network
of the same role takes its place without a change of code.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from queue import SimpleQueue
from typing import Annotated, Any, Literal, get_args

import numpy as np
from annotated_types import Ge, MinLen
from pydantic import Strict, TypeAdapter, ValidationError

from service.arrays import Float32
from service.errors import ModelFault, OutOfMemory, UsageError
from service.machine import processors
from service.runtime import compiled_networks
from service.runtime.network_registry import networks_of
from service.runtime.sessions import (
    MODELS,
    checked_bytes,
    has_openvino,
    lacked_memory,
    native_session,
    openvino_library,
    release,
    require_finite,
)

KEY = "description"

_Count = Annotated[int, Strict(), Ge(1)]
_Names = Annotated[tuple[str, ...], MinLen(1)]


@dataclass(frozen=True)
class Description:
    """One network that maps planes to planes: input "maps" (1, C, H, W), output "result" (1, K, scale (H - 2 margin),
    scale (W - 2 margin)).

    Attributes:
        network: role, for example "rho".
        channels: C names of the input planes in order.
        outputs: K names of the output planes in order; or one name for any number of planes of a kind.
        stride: H and W have to be multiples of it.
        margin: input pixels at each side that the result is without: what lies beyond hardly matters to it. A multiple
            of ``stride``.
        scale: output pixels per input pixel.
        whole: (width, height) of an input that is never cut into tiles; None for tiles of any size.
    """

    network: str
    channels: _Names
    outputs: _Names
    stride: _Count = 1
    margin: Annotated[int, Strict(), Ge(0)] = 0
    scale: _Count = 1
    whole: tuple[_Count, _Count] | None = None

    def planes(self, count: int) -> tuple[str, ...]:
        """Names of ``count`` output planes: ``outputs``, or the one name numbered from 0 where there are several."""
        if len(self.outputs) == 1 and count > 1:
            return tuple(f"{self.outputs[0].removesuffix('s')}_{index}" for index in range(count))
        return self.outputs

    @classmethod
    def parse(cls, text: str, name: str) -> Description:
        """Read the JSON text of the file of model ``name``.

        Raises:
            ModelFault: it is no description; the message says what is wrong with it.
        """
        try:
            found = TypeAdapter(cls).validate_json(text)
        except ValidationError as error:
            raise ModelFault(f"model {name}: its description cannot be read ({error}): {text[:200]!r}") from error
        if found.margin % found.stride:
            raise ModelFault(f"model {name}: margin {found.margin} is not a multiple of its stride {found.stride}")
        return found


RuntimeName = Literal["onnxruntime", "openvino"]
Precision = Literal["fp32", "bf16"]

RUNTIMES = ("auto", *get_args(RuntimeName))

INPUT, OUTPUT = "maps", "result"
_METADATA = ["framework", KEY]

ENLARGING = frozenset(networks_of("super_resolution"))
"""Networks that OpenVINO computes about twice as fast also with AVX2 alone. The others are level there, and start
sooner on onnxruntime."""

LANES = 2
"""Most tiles at once."""

_BF16 = frozenset({"amx_bf16", "avx512_bf16"})


_Compiled = Callable[[Float32], Float32]

Loaded = tuple[Description, _Compiled]
"""A network's description, and what computes it."""


@dataclass(frozen=True)
class Engine:
    """How networks are computed.

    Attributes:
        runtime: the library.
        precision: of products within the network; inputs and outputs are float32.
        threads: compute threads, >= 1.
        folder: where models.json and the files are.
        exceptions: names of networks that OpenVINO computes, in fp32, whatever ``runtime`` says.
        ahead: has loaded some networks already, or none.
    """

    runtime: RuntimeName = "onnxruntime"
    precision: Precision = "fp32"
    threads: int = 2
    folder: Path = MODELS
    exceptions: frozenset[str] = frozenset()
    ahead: Ahead | None = field(default=None, compare=False, repr=False)

    def of(self, name: str) -> Engine:
        """What network ``name`` runs on, without exceptions."""
        if name in self.exceptions:
            return replace(self, runtime="openvino", precision="fp32", exceptions=frozenset())
        return replace(self, exceptions=frozenset())

    def lanes(self, what: Description) -> int:
        """How many tiles of a network are computed at once, each by its share of the threads; 1 for whole maps.

        Two tiles by one thread each take a seventh less of the processor than one tile by both, which wait for each
        other after every layer; and nothing waits while a tile is read and written. More would take more memory.
        """
        return 1 if what.whole is not None else min(self.threads, LANES)

    def told(self, names: Iterable[str]) -> dict[str, str]:
        """Runtime and precision of each network in words, for example "openvino bf16"."""
        return {name: f"{one.runtime} {one.precision}" for name in names for one in [self.of(name)]}


@dataclass(eq=False)
class Network:
    """One loaded network.

    Attributes:
        name: its entry in models.json.
        description: what it takes and gives.
        engine: what it runs on.
        large: whether a map was computed whose memory is to be given back at the end.
    """

    name: str
    description: Description
    engine: Engine
    _compiled: _Compiled
    large: bool = False

    @property
    def lanes(self) -> int:
        """How many calls of :meth:`run` go on at once."""
        return self.engine.lanes(self.description)

    def run(self, maps: Float32) -> Float32:
        """(K, ...) float32, the result without the margin, of (C, H, W) float32, H and W multiples of the stride that
        leave some.

        Raises:
            ModelFault: the input or the output does not have the shape that the description promises, or the runtime
                failed; the cause is kept.
            OutOfMemory: the runtime got no memory.
            NumericFault: input or output holds NaN or Inf.
        """
        what = self.description
        channels, height, width = maps.shape
        least = 2 * what.margin + what.stride
        if channels != len(what.channels) or height % what.stride or width % what.stride or min(height, width) < least:
            raise ModelFault(
                f"network {self.name} got maps {maps.shape}; it takes {len(what.channels)} channels and sides that are "
                f"multiples of {what.stride}, {least} at least"
            )
        require_finite(self.name, "input", dict(zip(what.channels, maps, strict=True)))
        try:
            result = self._compiled(np.ascontiguousarray(maps[None], np.float32))
        except Exception as error:  # the runtimes' own exception types are not public
            if lacked_memory(error):
                raise OutOfMemory(f"the network {self.name} got no memory for maps {maps.shape}") from error
            raise ModelFault(f"network {self.name} failed on maps {maps.shape}: {error}") from error
        if not result.size:  # what OpenVINO gives, without a word, where it gets no memory for the result
            raise OutOfMemory(f"the network {self.name} got no memory for its result on maps {maps.shape}")
        names = what.planes(result.shape[1] if result.ndim == 4 else 0)
        tall, wide = ((side - 2 * what.margin) * what.scale for side in (height, width))
        expected = (1, len(names), tall, wide)
        if result.shape != expected:
            raise ModelFault(f"network {self.name} gave {result.shape}; its description promises {expected}")
        require_finite(self.name, "output", dict(zip(names, result[0], strict=True)))
        return np.asarray(result[0])


def choose_engine(runtime: str = "auto", *, threads: int = 0, precision: str = "auto", folder: Path = MODELS) -> Engine:
    """The engine for this machine.

    Args:
        runtime: of ``RUNTIMES``. "auto": OpenVINO where it is installed and the processor has AVX-512 or AMX; with AVX2
            alone for the networks of ``ENLARGING``; else onnxruntime. The same choice at every call on a machine.
        threads: compute threads; 0 means as many as this process may use.
        precision: "fp32", "bf16", or "auto": bf16 where OpenVINO runs and :func:`bf16_pays`.
        folder: of the models.

    Raises:
        UsageError: an unknown name; a runtime that is not installed; bf16 where it cannot be had.
    """
    if runtime not in RUNTIMES:
        raise UsageError(f"runtime is {runtime!r}; it has to be one of {', '.join(RUNTIMES)}", field="runtime")
    if precision not in ("auto", "fp32", "bf16"):
        raise UsageError(f"precision is {precision!r}; it has to be auto, fp32 or bf16", field="precision")
    here = has_openvino()
    wide = has_bf16() or has_feature("avx512f")
    if runtime == "openvino" and not here:
        raise UsageError("runtime is 'openvino', which is not installed: pip install openvino", field="runtime")
    chosen: RuntimeName = (
        "openvino" if runtime == "openvino" or (runtime == "auto" and here and wide) else "onnxruntime"
    )
    some = runtime == "auto" and here and not wide and has_feature("avx2")
    if precision == "bf16" and not (chosen == "openvino" and has_bf16()):
        raise UsageError("precision bf16 needs OpenVINO and a processor with AMX or AVX-512 BF16", field="precision")
    half = precision == "bf16" or (precision == "auto" and chosen == "openvino" and bf16_pays())
    computed: Precision = "bf16" if half else "fp32"
    return Engine(chosen, computed, threads or processors(), folder, ENLARGING if some else frozenset())


@contextmanager
def open_network(name: str, engine: Engine) -> Iterator[Network]:
    """A network for the length of a ``with`` block; its memory is freed at the end.

    Raises:
        ModelFault: the file is missing, not the one of models.json, has no description, or cannot be loaded.
    """
    description, compiled = (engine.ahead.take(name) if engine.ahead else None) or load_network(name, engine)
    held = [compiled]
    del compiled
    network = Network(name, description, engine.of(name), lambda maps: held[0](maps))
    try:
        yield network
    finally:
        held.clear()  # whoever keeps the Network, in a traceback for example, does not keep the weights
        if network.large:
            release()


def load_network(name: str, engine: Engine) -> Loaded:
    """What :func:`open_network` opens; raises as it does."""
    engine = engine.of(name)
    data = checked_bytes(name, engine.folder)
    return (_openvino if engine.runtime == "openvino" else _onnxruntime)(name, data, engine)


@lru_cache(maxsize=1)
def has_bf16() -> bool:
    """Whether the processor multiplies bfloat16 in hardware."""
    return any(has_feature(name) for name in _BF16)


@lru_cache(maxsize=1)
def bf16_pays() -> bool:
    """Whether bfloat16 is faster than float32: with AMX, or with AVX-512 BF16 where that is not Intel's.

    A Xeon whose AMX the virtual machine hides has AVX-512 BF16 too, and takes 1.5 times as long in bf16 as in fp32
    (processor time of delta and rho, one thread); an EPYC half as long.
    """
    from service import diagnosis

    intel = str(diagnosis.cpu().get("model", "")).startswith("Intel")
    return has_feature("amx_bf16") or (has_feature("avx512_bf16") and not intel)


@lru_cache
def has_feature(name: str) -> bool:
    """Whether the processor has an extension, by its name in /proc/cpuinfo."""
    from service import diagnosis

    features = diagnosis.cpu()["features"]
    return isinstance(features, list) and name in features


def lacks_openvino() -> bool:
    """Whether this processor would compute several times faster if OpenVINO were installed."""
    return bf16_pays() and not has_openvino()


def _parse(name: str, text: str | None) -> Description:
    if text is None:
        raise ModelFault(f"model {name} has no {KEY!r} among its metadata; it is no network of maps")
    return Description.parse(text, name)


def _onnxruntime(name: str, data: bytes, engine: Engine) -> Loaded:
    session = native_session(name, data, engine.threads, engine.folder)
    description = _parse(name, session.get_modelmeta().custom_metadata_map.get(KEY))
    return description, lambda maps: np.asarray(session.run([OUTPUT], {INPUT: maps})[0], np.float32)


def _openvino(name: str, data: bytes, engine: Engine) -> Loaded:
    try:
        core = openvino_library().Core()
        model = core.read_model(data)
        # Where OpenVINO keeps the metadata of an ONNX file.
        text = model.get_rt_info(_METADATA).astype(str) if model.has_rt_info(_METADATA) else None
        description = _parse(name, text)
        settings: dict[str, object] = {
            "NUM_STREAMS": engine.lanes(description),
            "INFERENCE_PRECISION_HINT": {"fp32": "f32", "bf16": "bf16"}[engine.precision],
            "INFERENCE_NUM_THREADS": engine.threads,
        }
        whole = _compiled(core, name, data, model, settings)
        idle: SimpleQueue[Any] = SimpleQueue()
        for _ in range(engine.lanes(description)):
            idle.put(whole.create_infer_request())
    except ModelFault:
        raise
    except Exception as error:  # OpenVINO's own exception types are not public
        if lacked_memory(error):
            raise OutOfMemory(f"the network {name} got no memory to be loaded") from error
        raise ModelFault(f"{engine.folder / name}: OpenVINO cannot load this model ({error})") from error

    def compute(maps: Float32) -> Float32:
        request = idle.get()
        try:
            found = request.infer({INPUT: maps}, share_inputs=True, share_outputs=True)
            return np.array(next(iter(found.values())), np.float32)  # a copy: the request's memory is used again
        finally:
            idle.put(request)

    return description, compute


def _compiled(core: Any, name: str, data: bytes, model: Any, settings: dict[str, object]) -> Any:
    """The model compiled for the processor, or read from where an earlier run kept it."""
    place = compiled_networks.place(name, data, openvino_library().get_version(), settings)
    blob = compiled_networks.read(place)
    if blob is not None:
        with contextlib.suppress(RuntimeError):  # of another build; it is compiled and kept anew
            return core.import_model(io.BytesIO(blob), "CPU", settings)
    made = core.compile_model(model, "CPU", settings)
    if place is not None:
        compiled_networks.write(place, bytes(made.export_model().getvalue()))
    return made


class Ahead:
    """Loads networks one after the other in a thread of its own; each is given away once.

    Attributes:
        engine: what they run on.
    """

    def __init__(self, names: Iterable[str], engine: Engine) -> None:
        self.engine = engine
        self._pool = ThreadPoolExecutor(1)
        self._loads: dict[str, Future[Loaded]] = {}
        self.load(names)

    def load(self, names: Iterable[str]) -> None:
        """Load these too, in their order, and drop all others."""
        before = self._loads
        self._loads = {name: before.get(name) or self._pool.submit(load_network, name, self.engine) for name in names}

    def take(self, name: str) -> Loaded | None:
        """A network, as soon as it is loaded; None where it was not asked for, or was taken before.

        Raises:
            AvatarError: as ``service.runtime.networks.load_network``.
        """
        found = self._loads.pop(name, None)
        return None if found is None or found.cancel() else found.result()

    def close(self) -> None:
        """Drop networks that nobody took, and cancel loads that have not begun."""
        self._loads.clear()
        self._pool.shutdown(cancel_futures=True)


@contextmanager
def loading_ahead(names: Iterable[str], engine: Engine, begun: Ahead | None = None) -> Iterator[Engine]:
    """The engine, with networks ``names`` being loaded in their order for the length of a ``with`` block.

    What has ``begun`` to load networks for the same engine goes on with these.
    """
    same = begun is not None and begun.engine == engine
    ahead = begun if begun is not None and same else Ahead((), engine)
    ahead.load(names)
    try:
        yield replace(engine, ahead=ahead)
    finally:
        ahead.close()
