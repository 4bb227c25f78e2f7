from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from export.faces import identity
from export.faces.onnx_tools import ParityError, run_onnx, worst_difference
from export.faces.parity import CHECKS, difference
from export.faces.tflite_tools import CUSTOM, with_builtin_operators


def small_weights() -> dict[str, identity.Stored]:
    """Random tensors in the shapes of the real network, quantised where the real ones are."""
    random = np.random.default_rng(0)
    weights: dict[str, identity.Stored] = {}

    def put(name: str, shape: tuple[int, ...], scale: float, low: float) -> None:
        weights[name] = identity.Stored(random.integers(0, 256, shape).astype(np.uint8), scale, low)

    def layer(name: str, size: int, inner: int, outer: int) -> None:
        width = 2 / np.sqrt(size * size * inner)
        put(f"{name}/conv/filters", (size, size, inner, outer), width / 255, -width / 2)
        put(f"{name}/conv/bias", (outer,), 1e-3, -0.1)
        put(f"{name}/scale/weights", (outer,), 2e-3, 0.5)
        put(f"{name}/scale/biases", (outer,), 1e-3, -0.1)

    layer("conv32_down", 7, 3, 32)
    channels = 32
    for name, _ in identity.UNITS:
        wide = int(name[4:7].rstrip("_"))
        layer(f"{name}/conv1", 3, channels, wide)
        layer(f"{name}/conv2", 3, wide, wide)
        channels = wide
    put("fc", (256, 128), 1e-3, -0.1)
    return weights


@pytest.mark.parametrize("name", sorted(CHECKS))
def test_shipped_networks_compute_what_their_sources_compute(name: str) -> None:
    assert difference(name) <= CHECKS[name].bound


def test_the_identity_graph_is_the_numpy_forward_pass(tmp_path: Path) -> None:
    """On other weights than the shipped ones: folding of scales, padding and pooling are right, not fitted."""
    pytest.importorskip("onnx")
    weights = small_weights()
    image = np.random.default_rng(1).uniform(0, 255, (150, 150, 3)).astype(np.float32)
    expected = identity.forward(weights, image)
    found = run_onnx(identity.build(weights).SerializeToString(), image[None])["embedding"][0]
    assert np.abs(expected).max() > 0.01
    assert np.abs(found - expected).max() < 1e-4 * np.abs(expected).max()


def tiny_model(values: np.ndarray) -> object:
    onnx = pytest.importorskip("onnx")
    weight = onnx.numpy_helper.from_array(values.astype(np.float32), "w")
    node = onnx.helper.make_node("Mul", ["image", "w"], ["out"])
    info = onnx.helper.make_tensor_value_info
    graph = onnx.helper.make_graph([node], "g", [info("image", 1, [300])], [info("out", 1, [300])], [weight])
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)])
    model.ir_version = 8
    return model


def test_the_gate_refuses_nan_and_other_outputs() -> None:
    good = {"out": np.ones(3, np.float32)}
    with pytest.raises(ParityError, match="finite"):
        worst_difference(good, {"out": np.array([1, np.nan, 1], np.float32)})
    with pytest.raises(ParityError, match="outputs"):
        worst_difference(good, {"other": np.ones(3, np.float32)})


def transposed(options: bytes, name: bytes) -> bytes:
    """A TFLite file of one custom operator: 2 x 2 x 3 numbers, a kernel of 2 x 2 for one channel, a bias."""
    pytest.importorskip("tensorflow", reason="TensorFlow is installed for conversion only")
    import flatbuffers
    from tensorflow.lite.python import schema_py_generated as schema

    model, graph, operator, code = (
        kind() for kind in (schema.ModelT, schema.SubGraphT, schema.OperatorT, schema.OperatorCodeT)
    )
    code.builtinCode = code.deprecatedBuiltinCode = schema.BuiltinOperator.CUSTOM
    code.customCode = name
    model.version, model.operatorCodes, model.subgraphs = 3, [code], [graph]
    values = [None, np.arange(12, dtype=np.float32) - 5, np.array([0.25], np.float32), None]
    graph.tensors, model.buffers = [], []
    for index, (shape, content) in enumerate(zip(([1, 2, 2, 3], [1, 2, 2, 3], [1], [1, 4, 4, 1]), values, strict=True)):
        tensor, buffer = schema.TensorT(), schema.BufferT()
        tensor.name, tensor.shape, tensor.buffer = f"t{index}".encode(), shape, index + 1
        buffer.data = None if content is None else list(content.tobytes())
        graph.tensors.append(tensor)
        model.buffers.append(buffer)
    model.buffers.insert(0, schema.BufferT())  # the empty one, by convention
    operator.opcodeIndex, operator.inputs, operator.outputs, operator.customOptions = 0, [0, 1, 2], [3], list(options)
    graph.operators, graph.inputs, graph.outputs = [operator], [0], [3]
    builder = flatbuffers.Builder(0)
    builder.Finish(model.Pack(builder), b"TFL3")
    return bytes(builder.Output())


@pytest.mark.filterwarnings("ignore::UserWarning")  # TensorFlow says that its interpreter moves
def test_mediapipes_own_operator_becomes_built_in_ones() -> None:
    """Against the sum of the kernel's copies: every input pixel lays one down, two pixels from the next."""
    data = transposed(np.array([1, 2, 2], "<i4").tobytes(), CUSTOM)
    import tensorflow as tf

    interpreter = tf.lite.Interpreter(model_content=with_builtin_operators(data))
    interpreter.allocate_tensors()
    image = np.random.default_rng(3).normal(size=(1, 2, 2, 3)).astype(np.float32)
    interpreter.set_tensor(interpreter.get_input_details()[0]["index"], image)
    interpreter.invoke()
    found = interpreter.get_tensor(interpreter.get_output_details()[0]["index"])[0, ..., 0]
    kernel = (np.arange(12) - 5.0).reshape(2, 2, 3)
    expected = np.einsum("yxc,abc->yaxb", image[0], kernel).reshape(4, 4) + 0.25
    np.testing.assert_allclose(found, expected, atol=1e-5)
