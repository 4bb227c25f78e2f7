"""Edits of TensorFlow Lite files before their conversion."""

from __future__ import annotations

from typing import Any

import numpy as np

CUSTOM = b"Convolution2DTransposeBias"
"""MediaPipe's own operator (mediapipe/util/tflite/operations/transpose_conv_bias.cc): a transposed convolution, then a
bias. Neither TensorFlow's interpreter nor tf2onnx knows it."""


def with_builtin_operators(data: bytes) -> bytes:
    """A TFLite file with MediaPipe's ``CUSTOM`` written as the built-in TRANSPOSE_CONV and ADD, which compute the same.

    Raises:
        ValueError: it has another custom operator.
    """
    import flatbuffers
    from tensorflow.lite.python import schema_py_generated as schema

    model = schema.ModelT.InitFromPackedBuf(data, 0)
    custom = {k for k, code in enumerate(model.operatorCodes) if code.customCode}
    other = {model.operatorCodes[k].customCode for k in custom} - {CUSTOM}
    if other:
        raise ValueError(f"no built-in operators are known for {', '.join(sorted(str(name) for name in other))}")
    if not custom:
        return data
    convolve, add = (_code(schema, model, name) for name in ("TRANSPOSE_CONV", "ADD"))
    for graph in model.subgraphs:
        graph.operators = [
            new
            for old in graph.operators
            for new in (_pair(schema, model, graph, old, convolve, add) if old.opcodeIndex in custom else (old,))
        ]
    builder = flatbuffers.Builder(len(data))
    builder.Finish(model.Pack(builder), b"TFL3")
    return bytes(builder.Output())


def _pair(schema: Any, model: Any, graph: Any, old: Any, convolve: int, add: int) -> tuple[Any, Any]:
    """The convolution and the addition that stand for one custom operator (inputs: image, kernel, bias)."""
    image, kernel, bias = (int(index) for index in old.inputs)
    # TfLiteTransposeConvParams: padding (1 same, 2 valid), width and height of the stride.
    padding, across, down = np.frombuffer(bytes(old.customOptions), "<i4")[:3].tolist()
    result = graph.tensors[old.outputs[0]]
    between = schema.TensorT()
    between.name, between.shape, between.type = result.name + b"/convolved", result.shape, result.type
    size = schema.TensorT()
    size.name, size.shape, size.type = result.name + b"/size", [4], schema.TensorType.INT32
    content = schema.BufferT()
    content.data = list(np.asarray(result.shape, "<i4").tobytes())
    size.buffer = len(model.buffers)
    model.buffers.append(content)
    first = len(graph.tensors)
    graph.tensors += [size, between]
    made = []
    for code, kind, inputs, output in (
        (convolve, "TransposeConv", [first, kernel, image], first + 1),
        (add, "Add", [first + 1, bias], int(old.outputs[0])),
    ):
        new = schema.OperatorT()
        new.opcodeIndex, new.inputs, new.outputs = code, inputs, [output]
        new.builtinOptionsType = getattr(schema.BuiltinOptions, kind + "Options")
        new.builtinOptions = getattr(schema, kind + "OptionsT")()
        made.append(new)
    made[0].builtinOptions.padding = schema.Padding.SAME if padding == 1 else schema.Padding.VALID
    made[0].builtinOptions.strideW, made[0].builtinOptions.strideH = across, down
    return made[0], made[1]


def _code(schema: Any, model: Any, name: str) -> int:
    """Index of a built-in operator in the model's table, where it is put if missing."""
    number = getattr(schema.BuiltinOperator, name)
    for index, code in enumerate(model.operatorCodes):
        if max(code.builtinCode, code.deprecatedBuiltinCode) == number:
            return index
    code = schema.OperatorCodeT()
    code.builtinCode = code.deprecatedBuiltinCode = number
    code.version = 1
    model.operatorCodes.append(code)
    return len(model.operatorCodes) - 1
