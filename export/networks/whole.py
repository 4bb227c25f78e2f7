"""Networks that see their input whole and answer by several named tensors: torch -> ONNX, through a gate."""

from __future__ import annotations

import io
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from export.faces.onnx_tools import ParityError, store_half
from export.networks.convert import BOUND, OPSET


def convert(
    network: nn.Module, entry: str, example: Tensor, outputs: Sequence[str], scales: Mapping[str, float]
) -> tuple[bytes, float]:
    """The ONNX file of a network, and its largest difference from torch.

    Args:
        network: with weights that float16 holds exactly.
        entry: name of the input, an image in [0, 1].
        example: of the input's shape.
        outputs: their names, in the order of the network's.
        scales: what the difference is divided by where an output is not of about [-1, 1].

    Raises:
        ParityError: values that are not finite, or a difference over the bound of all networks.
    """
    data: bytes = _to_onnx(network, entry, example, outputs).SerializeToString(deterministic=True)
    return data, _check(network, data, entry, example, outputs, scales)


def _to_onnx(network: nn.Module, entry: str, example: Tensor, outputs: Sequence[str]) -> Any:
    import onnx

    buffer = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # deprecation of the exporter that needs no further packages
        torch.onnx.export(
            network, (example,), buffer, input_names=[entry], output_names=list(outputs), opset_version=OPSET,
            dynamo=False, do_constant_folding=False,
        )  # fmt: skip
    model = store_half(onnx.load_from_string(buffer.getvalue()))
    onnx.checker.check_model(model, full_check=True)
    return model


def _check(
    network: nn.Module, data: bytes, entry: str, example: Tensor, outputs: Sequence[str], scales: Mapping[str, float]
) -> float:
    import onnxruntime as ort

    session = ort.InferenceSession(data, providers=["CPUExecutionProvider"])
    noise = torch.rand(example.shape, generator=torch.Generator().manual_seed(5))
    worst = 0.0
    for image in (noise, torch.zeros_like(noise), nn.functional.avg_pool2d(noise, 9, 1, 4)):
        with torch.no_grad():
            expected = [value.numpy() for value in network(image)]
        for name, one, other in zip(outputs, session.run(list(outputs), {entry: image.numpy()}), expected, strict=True):
            if one.shape != other.shape or not np.isfinite(one).all():
                raise ParityError(f"{name} is {one.shape} instead of {other.shape}, or not finite")
            worst = max(worst, float(np.abs(one - other).max()) / scales.get(name, 1.0))
    if not worst <= BOUND:
        raise ParityError(f"off by {worst:.1e}, at most {BOUND} is allowed; nothing written")
    return worst
