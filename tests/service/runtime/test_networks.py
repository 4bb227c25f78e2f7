"""Loading, describing and refusing networks of maps; the runtimes agree."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from service.errors import ModelFault, NumericFault, UsageError
from service.runtime import networks
from service.runtime.describe import Description
from service.runtime.networks import Engine, choose_engine, describe, open_network
from tests.service.runtime.toynets import finish, toy_net, write_models

GOOD = {"network": "n", "channels": ["a"], "outputs": ["x"], "stride": 8, "halo": 64, "scale": 1, "whole": None}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_models(tmp_path, {"one": toy_net("one", ["a"], ["x"]), "two": toy_net("two", ["a"], ["x"], seed=1)})


def engine(folder: Path) -> Engine:
    return Engine(threads=1, folder=folder)


def test_the_description_is_that_of_the_file(folder: Path) -> None:
    expected = Description("one", ("a",), ("x",), stride=2, halo=16)
    assert describe("one", folder) == expected
    with open_network("one", engine(folder)) as network:
        assert network.description == expected


@pytest.mark.parametrize(
    "change",
    [
        {"channels": []}, {"channels": "rgb"}, {"channels": None}, {"outputs": []}, {"stride": 0}, {"stride": 1.5},
        {"halo": -8}, {"halo": 60}, {"scale": 0}, {"scale": True}, {"whole": [0, 3]}, {"whole": [3]}, {"network": ...},
    ],
)  # fmt: skip
def test_a_bad_description_is_a_model_fault_that_names_the_model(change: dict[str, object]) -> None:
    content = {key: value for key, value in (GOOD | change).items() if value is not ...}
    with pytest.raises(ModelFault, match="model n"):
        Description.parse(json.dumps(content), "n")


@pytest.mark.parametrize("text", ["", "[]", "3", "{", '{"whole": "wide"}'])
def test_text_that_is_no_description(text: str) -> None:
    with pytest.raises(ModelFault, match="model n"):
        Description.parse(text, "n")


def test_a_network_without_description_is_refused(tmp_path: Path) -> None:
    model = onnx.load_from_string(toy_net("bare", ["a"], ["x"]))
    del model.metadata_props[:]
    write_models(tmp_path, {"bare": bytes(model.SerializeToString())})
    with pytest.raises(ModelFault, match="bare has no 'description'"):
        describe("bare", tmp_path)


def test_a_flipped_bit_is_refused_by_hash(folder: Path) -> None:
    path = folder / "one.onnx"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(ModelFault, match=r"one\.onnx: sha256"), open_network("one", engine(folder)):
        pass


def test_swapped_files_are_refused_by_hash(folder: Path) -> None:
    """Two networks of the same shape: only the hash can tell them apart."""
    shutil.copy(folder / "two.onnx", folder / "one.onnx")
    with pytest.raises(ModelFault, match=r"one\.onnx: sha256"), open_network("one", engine(folder)):
        pass


def test_shapes_that_the_description_forbids(folder: Path) -> None:
    with open_network("one", engine(folder)) as network:
        for shape in ((2, 8, 8), (1, 7, 8), (1, 8, 9), (1, 0, 8)):
            with pytest.raises(ModelFault, match="multiples of 2"):
                network.run(np.zeros(shape, np.float32))


def test_a_description_that_lies_about_the_output(tmp_path: Path) -> None:
    data = finish([helper.make_node("Identity", ["maps"], ["result"])], [], "liar", ["a"], ["x"], scale=2)
    write_models(tmp_path, {"liar": data})
    with open_network("liar", engine(tmp_path)) as network, pytest.raises(ModelFault, match="promises"):
        network.run(np.zeros((1, 4, 4), np.float32))


def test_what_is_not_finite_stops_at_the_door(tmp_path: Path) -> None:
    power = helper.make_tensor("big", TensorProto.FLOAT, [1], [1e38])
    write_models(
        tmp_path, {"big": finish([helper.make_node("Mul", ["maps", "big"], ["result"])], [power], "big", ["a"], ["x"])}
    )
    with open_network("big", engine(tmp_path)) as network:
        maps = np.zeros((1, 4, 4), np.float32)
        assert np.isfinite(network.run(maps)).all()
        maps[0, 1, 1] = 1e5
        with pytest.raises(NumericFault, match="output x has 1 of 16"):
            network.run(maps)
        maps[0, 1, 1] = np.inf
        with pytest.raises(NumericFault, match="input a has 1 of 16"):
            network.run(maps)


def test_the_weights_are_released_at_the_end(folder: Path) -> None:
    with open_network("one", engine(folder)) as network:
        pass
    with pytest.raises(ModelFault, match="failed"):
        network.run(np.zeros((1, 8, 8), np.float32))


@pytest.mark.parametrize(("here", "fast", "expected"), [
    (True, True, ("openvino", "bf16")), (True, False, ("onnxruntime", "fp32")), (False, True, ("onnxruntime", "fp32")),
])  # fmt: skip
def test_auto_takes_openvino_where_it_is_faster(
    here: bool, fast: bool, expected: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(networks, "has_openvino", lambda: here)
    monkeypatch.setattr(networks, "has_bf16", lambda: fast)
    chosen = choose_engine("auto", threads=3)
    assert (chosen.runtime, chosen.precision, chosen.threads) == (*expected, 3)
    assert choose_engine("auto", precision="fp32").precision == "fp32"
    if not here:
        with pytest.raises(UsageError, match="not installed"):
            choose_engine("openvino")
    if not (here and fast):
        with pytest.raises(UsageError, match="bf16"):
            choose_engine(precision="bf16")


def test_unknown_names_are_refused() -> None:
    with pytest.raises(UsageError, match="'tensorrt'"):
        choose_engine("tensorrt")
    with pytest.raises(UsageError, match="'int4'"):
        choose_engine(precision="int4")
    assert choose_engine().threads >= 1


def test_openvino_computes_the_same(folder: Path) -> None:
    """Two sizes, one not square, as the shapes are dynamic."""
    pytest.importorskip("openvino")
    rng = np.random.default_rng(0)
    with (
        open_network("one", engine(folder)) as plain,
        open_network("one", Engine("openvino", "fp32", 1, folder)) as other,
    ):
        for shape in ((1, 16, 16), (1, 40, 24), (1, 16, 16)):
            maps = rng.uniform(-1, 1, shape).astype(np.float32)
            np.testing.assert_allclose(other.run(maps), plain.run(maps), atol=1e-4)
