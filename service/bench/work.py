"""Operations of a network, counted from its graph: multiply-adds of convolutions and matrix products.

The runtime knows the shape of every tensor once it has run the graph; its profile of one run on a small map, with no
node fused or folded, has them. Other operations (activations, sums, resizing) are not counted, as this is for a lower
bound.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from service.runtime.networks import INPUT, OUTPUT, describe
from service.runtime.sessions import checked_bytes, profile

SIDE = 128
"""Side of the square on which networks for tiles are counted, pixels, rounded to the stride."""


@dataclass(frozen=True)
class Work:
    """Operations and memory traffic of one network.

    Attributes:
        multiply_adds: of one pixel of input where the network runs in tiles; of one run where it takes a whole map.
        numbers: float32 numbers of input and output, per pixel of input, or of one run likewise.
        weights: bytes of the file.
    """

    multiply_adds: float
    numbers: float
    weights: int


def count(name: str, folder: Path) -> Work:
    """Work of network ``name``.

    Raises:
        ModelFault: as ``service.runtime.networks.open_network``, or the network cannot run.
    """
    data, what = checked_bytes(name, folder), describe(name, folder)
    side = max(SIDE // what.stride, 1) * what.stride
    width, height = what.whole or (side, side)
    maps = np.zeros((1, len(what.channels), height, width), np.float32)
    with tempfile.TemporaryDirectory() as scratch:
        outputs, text = profile(name, data, {INPUT: maps}, [OUTPUT], Path(scratch), folder)
    total = multiply_adds(nodes(json.loads(text)))
    numbers = maps.size + outputs[0].size
    area = 1 if what.whole else width * height
    return Work(total / area, numbers / area, len(data))


def nodes(events: Iterable[Mapping[str, Any]]) -> Iterable[Mapping[str, Any]]:
    """Arguments of the node events of a profile, one per node."""
    for event in events:
        if event.get("cat") == "Node" and str(event.get("name", "")).endswith("_kernel_time"):
            yield event["args"]


def multiply_adds(found: Iterable[Mapping[str, Any]]) -> int:
    """Sum over nodes of a profile. Each output number of a convolution takes C_in / groups k_h k_w multiply-adds."""
    total = 0
    for node in found:
        inputs, outputs = _shapes(node["input_type_shape"]), _shapes(node["output_type_shape"])
        if node["op_name"] == "Conv":
            total += math.prod(outputs[0]) * math.prod(inputs[1][1:])
        elif node["op_name"] == "ConvTranspose":
            total += math.prod(inputs[0]) * math.prod(inputs[1][1:])
        elif node["op_name"] in ("MatMul", "Gemm"):
            total += math.prod(outputs[0]) * inputs[0][-1]
    return total


def _shapes(listed: Iterable[Mapping[str, list[int]]]) -> list[list[int]]:
    return [list(next(iter(entry.values()))) for entry in listed]
