"""Peak rates of this machine: floating-point operations and bytes per second."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from service.runtime.networks import has_bf16
from service.runtime.sessions import has_openvino, openvino_library

SIDE = 1536
"""Side of the matrices that are multiplied: too large for caches, yet a fraction of a second."""

COPIED = 64 * 2**20
"""Bytes that each thread copies."""


@dataclass(frozen=True)
class Rates:
    """Floating-point operations (a multiply-add is two) per second by precision; bytes read and written per second."""

    operations: dict[str, float]
    bytes: float

    def floor(self, operations: float, moved: float, precision: str) -> float | None:
        """Lower bound of the time on this machine in seconds; None where the precision's rate was not measured."""
        if operations and precision not in self.operations:
            return None
        return max(operations / self.operations[precision] if operations else 0.0, moved / self.bytes)


def measure(threads: int, side: int = SIDE, copied: int = COPIED) -> Rates:
    """Time matrix products and copies with ``threads`` threads.

    numpy uses as many threads as OPENBLAS_NUM_THREADS said when the process began. Where OpenVINO is installed, the
    faster of both counts.
    """
    operations = {"fp32": 2.0 * side**3 / _numpy_product(side)}
    if has_openvino():
        operations["fp32"] = max(operations["fp32"], 2.0 * side**3 / _openvino_product(side, threads, "f32"))
        if has_bf16():
            operations["bf16"] = 2.0 * side**3 / _openvino_product(side, threads, "bf16")
    return Rates(operations, _copy_rate(threads, copied))


def best_of(times: int, work: Callable[[], object]) -> float:
    """Seconds of the fastest of ``times`` runs."""
    seconds = []
    for _ in range(max(times, 1)):
        begin = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - begin)
    return max(min(seconds), 1e-9)


def _matrices(side: int) -> tuple[np.ndarray[tuple[int, int], np.dtype[np.float32]], ...]:
    rng = np.random.default_rng(0)
    return tuple(rng.standard_normal((side, side), np.float32) for _ in range(2))


def _numpy_product(side: int) -> float:
    a, b = _matrices(side)
    out = np.zeros_like(a)
    return best_of(4, lambda: np.matmul(a, b, out=out))


def _openvino_product(side: int, threads: int, precision: str) -> float:
    openvino = openvino_library()
    from openvino import opset13

    shape, kind = openvino.Shape([side, side]), openvino.Type.f32
    parameters = [opset13.parameter(shape, kind) for _ in range(2)]
    model = openvino.Model([opset13.matmul(*parameters, False, False)], parameters)
    settings = {"INFERENCE_NUM_THREADS": threads, "NUM_STREAMS": 1, "INFERENCE_PRECISION_HINT": precision}
    request = openvino.Core().compile_model(model, "CPU", settings).create_infer_request()
    inputs = _matrices(side)
    return best_of(4, lambda: request.infer(list(inputs), share_inputs=True, share_outputs=True))


def _copy_rate(threads: int, copied: int) -> float:
    sources = [np.full(copied, index, np.uint8) for index in range(threads)]
    targets = [np.zeros(copied, np.uint8) for _ in range(threads)]
    with ThreadPoolExecutor(threads) as pool:
        seconds = best_of(5, lambda: list(pool.map(np.copyto, targets, sources)))
    return 2.0 * copied * threads / seconds
