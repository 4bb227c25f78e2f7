from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from export.faces import identity
from export.faces.mirror import derive
from export.faces.onnx_tools import ParityError, run_onnx, store_half, worst_difference, write_gated
from export.faces.parity import CHECKS, difference
from service.face.topology import MIRROR


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


def test_the_gate_writes_nothing_when_off(tmp_path: Path) -> None:
    image = np.ones(300, np.float32)
    target = tmp_path / "m.onnx"
    with pytest.raises(ParityError, match="nothing written"):
        write_gated(tiny_model(np.ones(300)), target, [(image, {"out": image * 1.01})], 1e-3)
    assert not target.exists()
    assert write_gated(tiny_model(np.ones(300)), target, [(image, {"out": image})], 1e-3) == 0.0
    assert target.exists()


def test_the_gate_refuses_nan_and_other_outputs() -> None:
    good = {"out": np.ones(3, np.float32)}
    with pytest.raises(ParityError, match="finite"):
        worst_difference(good, {"out": np.array([1, np.nan, 1], np.float32)})
    with pytest.raises(ParityError, match="outputs"):
        worst_difference(good, {"other": np.ones(3, np.float32)})


def test_half_storage_only_where_nothing_is_lost() -> None:
    image = np.ones(300, np.float32)
    for values, halved in ((np.linspace(0, 1, 300), False), (np.arange(300) / 8, True)):
        model = store_half(tiny_model(values))
        types = {t.data_type for t in model.graph.initializer}
        assert (10 in types) == halved  # TensorProto.FLOAT16
        assert np.array_equal(run_onnx(model.SerializeToString(), image)["out"], values.astype(np.float32))


def test_the_mirror_table_can_be_derived_again() -> None:
    assert tuple(derive(12)) == MIRROR
