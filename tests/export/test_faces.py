from __future__ import annotations

import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest

from export.faces import identity
from export.faces.mediapipe import members, read_member
from export.faces.onnx_tools import ParityError, plain_resize, run_onnx, store_half, worst_difference
from export.faces.parity import CHECKS, difference


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


def test_rounded_weights_are_gated_by_their_mean_and_exact_ones_by_the_worst() -> None:
    """A network in single precision moves single pixels of noise far when it is rounded; one in half moves none."""
    values = np.random.default_rng(2).normal(size=300)
    image = np.ones(300, np.float32)
    plain, exact, rounded = (
        run_onnx(model.SerializeToString(), image)
        for model in (tiny_model(values), store_half(tiny_model(values)), store_half(tiny_model(values), rounded=True))
    )
    assert worst_difference(plain, exact) == 0
    worst, mean = (worst_difference(plain, rounded, mean=one) for one in (False, True))
    assert 0 < mean < worst < 2e-3
    half = values.astype(np.float16)
    assert worst_difference({"out": half.astype(np.float32)}, rounded) == 0


def test_the_nearest_pixel_is_the_same_without_what_onnxruntime_warns_of() -> None:
    onnx = pytest.importorskip("onnx")
    helper, image = onnx.helper, np.random.default_rng(3).random((1, 1, 4, 4), np.float32)
    node = helper.make_node(
        "Resize", ["image", "", "by"], ["out"], mode="nearest", nearest_mode="floor",
        coordinate_transformation_mode="tf_half_pixel_for_nn",
    )  # fmt: skip
    by = onnx.numpy_helper.from_array(np.array([1, 1, 2, 2], np.float32), "by")
    shapes = [helper.make_tensor_value_info(name, 1, shape) for name, shape in (("image", [1, 1, 4, 4]), ("out", None))]
    graph = helper.make_graph([node], "g", shapes[:1], shapes[1:], [by])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    plain = plain_resize(model)
    assert plain.graph.node[0].attribute != model.graph.node[0].attribute
    found = run_onnx(plain.SerializeToString(), image)["out"]
    np.testing.assert_array_equal(found[0, 0], np.kron(image[0, 0], np.ones((2, 2))))


def test_networks_are_found_in_zips_and_tars(tmp_path: Path) -> None:
    zipped, tarred = tmp_path / "one.whl", tmp_path / "one.tgz"
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x.tflite").write_bytes(b"network")
    with zipfile.ZipFile(zipped, "w") as archive:
        archive.writestr("a/x.tflite", b"network")
    with tarfile.open(tarred, "w:gz") as tar:
        tar.add(tmp_path / "a", "a")
    for file in (zipped, tarred):
        assert "a/x.tflite" in members(file)
        assert read_member(file, "a/x.tflite") == b"network"
