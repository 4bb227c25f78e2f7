"""Small edits of ONNX graphs, and the gate that every converted file has to pass."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Arrays = dict[str, npt.NDArray[np.float32]]


class ParityError(RuntimeError):
    """A converted network does not compute what its source computes; no file was written."""


def rename(model: Any, names: dict[str, str]) -> Any:
    """A copy of the ONNX model with the tensors in ``names`` (old -> new) renamed everywhere."""
    copy = type(model)()
    copy.CopyFrom(model)
    graph = copy.graph
    for node in graph.node:
        node.input[:] = [names.get(n, n) for n in node.input]
        node.output[:] = [names.get(n, n) for n in node.output]
    for value in (*graph.input, *graph.output, *graph.value_info, *graph.initializer):
        value.name = names.get(value.name, value.name)
    return copy


def thinned(values: npt.NDArray[np.float32], every: int) -> npt.NDArray[np.float32]:
    """Flat values of an output; of a map (1, H, W, C) each ``every``-th row and column."""
    return np.asarray(values if every == 1 else values[:, ::every, ::every], np.float32).ravel()


def plain_resize(model: Any) -> Any:
    """A copy of the ONNX model without the deprecated ``tf_half_pixel_for_nn``, which onnxruntime warns of.

    Enlarged by whole numbers, the nearest pixel of "half_pixel" is the same.
    """
    copy = type(model)()
    copy.CopyFrom(model)
    for node in copy.graph.node:
        told = {a.name: a for a in node.attribute}
        if node.op_type == "Resize" and told["coordinate_transformation_mode"].s == b"tf_half_pixel_for_nn":
            told["coordinate_transformation_mode"].s = b"half_pixel"
            told["nearest_mode"].s = b"round_prefer_floor"
    return copy


def store_half(model: Any, smallest: int = 256, *, rounded: bool = False) -> Any:
    """A copy whose larger float32 initialisers are stored as float16 with a Cast behind them, where that loses nothing.

    With ``rounded`` also where it does: weights within half's range are rounded to it.

    Networks that were published in half precision come out of the converter widened to float32. The runtime folds the
    casts when it loads the graph, so arithmetic stays float32 and the values exact; only the file shrinks.
    """
    from onnx import TensorProto, helper, numpy_helper

    copy = type(model)()
    copy.CopyFrom(model)
    kept, casts = [], []
    for tensor in copy.graph.initializer:
        values = numpy_helper.to_array(tensor)
        with np.errstate(over="ignore"):
            half = values.astype(np.float16)
        exact = np.isfinite(half).all() if rounded else np.array_equal(half.astype(np.float32), values)
        if values.dtype != np.float32 or values.size < smallest or not exact:
            kept.append(tensor)
            continue
        kept.append(numpy_helper.from_array(half, tensor.name + "_f16"))
        casts.append(helper.make_node("Cast", [tensor.name + "_f16"], [tensor.name], to=TensorProto.FLOAT))
    nodes = [*casts, *copy.graph.node]
    del copy.graph.initializer[:], copy.graph.node[:]
    copy.graph.initializer.extend(kept)
    copy.graph.node.extend(nodes)
    return copy


def run_onnx(model_bytes: bytes, image: npt.NDArray[np.float32]) -> Arrays:
    """Outputs by name of a serialised model with a single input."""
    import onnxruntime as ort

    options = ort.SessionOptions()
    options.intra_op_num_threads = 2
    session = ort.InferenceSession(model_bytes, options, providers=["CPUExecutionProvider"])
    names = [o.name for o in session.get_outputs()]
    return dict(zip(names, session.run(names, {session.get_inputs()[0].name: image}), strict=True))


def worst_difference(reference: Arrays, candidate: Arrays, *, mean: bool = False) -> float:
    """Largest difference over all outputs; ParityError when names, sizes or finiteness differ.

    With ``mean`` that of the output whose mean difference is largest: rounded weights move single pixels of noise far.

    Absolute up to magnitudes of 256 (a crop's width in pixels), relative to the largest value / 256 beyond: on flat
    black, detectors can answer in the tens of thousands, where float32 itself is coarser than the bounds.
    """
    if set(reference) != set(candidate):
        raise ParityError(f"outputs {sorted(candidate)} instead of {sorted(reference)}")
    worst = 0.0
    for name, expected in reference.items():
        got = candidate[name]
        if got.size != expected.size or not np.isfinite(got).all():
            raise ParityError(f"output {name}: {got.shape} instead of {expected.shape}, or not finite")
        unit = max(1.0, float(np.abs(expected).max()) / 256)
        off = np.abs(got.ravel() - expected.ravel())
        worst = max(worst, float(off.mean() if mean else off.max()) / unit)
    return worst


def write_gated(
    model: Any, path: Path, references: list[tuple[npt.NDArray[np.float32], Arrays]], bound: float,
    *, mean: bool = False,
) -> float:  # fmt: skip
    """Check the ONNX model against (input, reference outputs) pairs, then write it; returns the worst difference.

    Raises ParityError, leaving ``path`` untouched, when any output is off by more than ``bound``.
    """
    import onnx

    onnx.checker.check_model(model)
    data = model.SerializeToString(deterministic=True)
    worst = max(worst_difference(expected, run_onnx(data, image), mean=mean) for image, expected in references)
    if not worst <= bound:
        raise ParityError(f"{path.name}: off by {worst:.3g}, at most {bound:.3g} is allowed; nothing written")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return worst
