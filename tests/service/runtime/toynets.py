"""Small ONNX networks of maps with random weights and a known reach, and the folder that lists them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper


def toy_net(
    network: str,
    channels: Sequence[str],
    outputs: Sequence[str],
    *,
    scale: int = 1,
    margin: int = 16,
    whole: tuple[int, int] | None = None,
    seed: int = 0,
    gain: float = 1.0,
) -> bytes:
    """Convolution, a half-size branch (stride 2), tanh; with ``scale`` a depth-to-space at the end. fp16 weights."""
    rng = np.random.default_rng(seed)
    initialisers, nodes = [], []

    def conv(source: str, target: str, count_in: int, count_out: int, **attributes: Any) -> None:
        weights = rng.normal(0, gain / np.sqrt(9 * count_in), (count_out, count_in, 3, 3)).astype(np.float16)
        initialisers.append(numpy_helper.from_array(weights, f"{target}_half"))
        nodes.append(helper.make_node("Cast", [f"{target}_half"], [f"{target}_weights"], to=TensorProto.FLOAT))
        bias = numpy_helper.from_array(rng.normal(0, 0.1, count_out).astype(np.float32), f"{target}_bias")
        initialisers.append(bias)
        inputs = [source, f"{target}_weights", f"{target}_bias"]
        nodes.append(helper.make_node("Conv", inputs, [target], pads=[1] * 4, **attributes))

    inner = 6
    conv("maps", "first", len(channels), inner)
    nodes.append(helper.make_node("LeakyRelu", ["first"], ["active"], alpha=0.2))
    conv("active", "down", inner, inner, strides=[2, 2])
    nodes.append(helper.make_node("Tanh", ["down"], ["small"]))
    conv("small", "middle", inner, inner * 4)
    nodes.append(helper.make_node("DepthToSpace", ["middle"], ["up"], blocksize=2))
    nodes.append(helper.make_node("Add", ["up", "active"], ["both"]))
    conv("both", "last", inner, len(outputs) * scale * scale)
    nodes.append(helper.make_node("Tanh", ["last"], ["bounded"]))
    nodes.append(helper.make_node("DepthToSpace", ["bounded"], ["all"], blocksize=scale))
    margin = 0 if whole else margin
    ends = {"begin": [margin * scale] * 2, "end": [-margin * scale or 2**31] * 2, "axes": [2, 3]}
    initialisers += [numpy_helper.from_array(np.array(values), name) for name, values in ends.items()]
    nodes.append(helper.make_node("Slice", ["all", *ends], ["result"]))
    return finish(nodes, initialisers, network, channels, outputs, scale=scale, margin=margin, whole=whole, stride=2)


def finish(
    nodes: list[Any],
    initialisers: list[Any],
    network: str,
    channels: Sequence[str],
    outputs: Sequence[str],
    **facts: Any,
) -> bytes:
    """Bytes of the model with its description."""
    maps = helper.make_tensor_value_info("maps", TensorProto.FLOAT, [1, len(channels), "height", "width"])
    result = helper.make_tensor_value_info("result", TensorProto.FLOAT, [1, len(outputs), "tall", "wide"])
    graph = helper.make_graph(nodes, network, [maps], [result], initialisers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    description = {"network": network, "channels": list(channels), "outputs": list(outputs), **facts}
    helper.set_model_props(model, {"description": json.dumps(description)})
    onnx.checker.check_model(model)
    return bytes(model.SerializeToString())


def write_models(folder: Path, models: Mapping[str, bytes]) -> Path:
    """Put models and their table into a folder."""
    entries = []
    for name, data in models.items():
        (folder / f"{name}.onnx").write_bytes(data)
        digest = hashlib.sha256(data).hexdigest()
        entries.append(
            {"name": name, "file": f"{name}.onnx", "sha256": digest, "bytes": len(data), "licence": "CC0-1.0"}
        )
    (folder / "models.json").write_text(json.dumps({"models": entries}))
    return folder
