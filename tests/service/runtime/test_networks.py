"""Networks by their descriptions, on each runtime, and loaded ahead."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from service.errors import ModelFault, NumericFault, UsageError
from service.runtime import networks
from service.runtime.networks import (
    Description,
    Engine,
    RuntimeName,
    choose_engine,
    load_network,
    loading_ahead,
    open_network,
)
from service.runtime.sessions import has_openvino
from tests.service.runtime.toynets import finish, toy_net, write_models

RUNTIMES_HERE: tuple[RuntimeName, ...] = ("onnxruntime", "openvino") if has_openvino() else ("onnxruntime",)
GOOD = {"network": "n", "channels": ["a"], "outputs": ["x"], "stride": 8, "margin": 64, "scale": 1, "whole": None}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_models(tmp_path, {"one": toy_net("one", ["a"], ["x"]), "two": toy_net("two", ["a"], ["x"], seed=1)})


def engine(folder: Path) -> Engine:
    return Engine(threads=1, folder=folder)


@pytest.mark.parametrize(
    "change",
    [
        {"channels": []}, {"channels": "rgb"}, {"channels": None}, {"outputs": []}, {"stride": 0}, {"stride": 1.5},
        {"margin": -8}, {"margin": 60}, {"scale": 0}, {"scale": True}, {"whole": [0, 3]}, {"whole": [3]},
        {"network": ...},
    ],
)  # fmt: skip
def test_a_bad_description_is_a_model_fault_that_names_the_model(change: dict[str, object]) -> None:
    content = {key: value for key, value in (GOOD | change).items() if value is not ...}
    with pytest.raises(ModelFault, match="model n"):
        Description.parse(json.dumps(content), "n")


def test_a_network_without_description_is_refused(tmp_path: Path) -> None:
    model = onnx.load_from_string(toy_net("bare", ["a"], ["x"]))
    del model.metadata_props[:]
    write_models(tmp_path, {"bare": bytes(model.SerializeToString())})
    for runtime in RUNTIMES_HERE:
        with pytest.raises(ModelFault, match="bare has no 'description'"):
            load_network("bare", Engine(runtime, threads=1, folder=tmp_path))


def test_shapes_that_the_description_forbids(folder: Path) -> None:
    with open_network("one", engine(folder)) as network:
        for shape in ((2, 48, 48), (1, 47, 48), (1, 48, 49), (1, 0, 48), (1, 32, 48)):
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


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """Makes this a machine with some processor extensions, with or without OpenVINO."""

    def become(*features: str, openvino: bool = True, model: str = "") -> None:
        monkeypatch.setattr("service.diagnosis.cpu", lambda: {"model": model, "features": list(features)})
        monkeypatch.setattr(networks, "has_openvino", lambda: openvino)
        networks.has_bf16.cache_clear()
        networks.bf16_pays.cache_clear()
        networks.has_feature.cache_clear()

    yield become
    monkeypatch.undo()
    networks.has_bf16.cache_clear()
    networks.bf16_pays.cache_clear()
    networks.has_feature.cache_clear()


@pytest.mark.parametrize(("features", "openvino", "zeta", "rho"), [
    (("avx2", "avx512f", "amx_bf16"), True, "openvino bf16", "openvino bf16"),
    (("avx2", "avx512f"), True, "openvino fp32", "openvino fp32"),
    (("avx2",), True, "openvino fp32", "onnxruntime fp32"),
    (("asimd",), True, "onnxruntime fp32", "onnxruntime fp32"),
    (("avx2", "avx512f", "amx_bf16"), False, "onnxruntime fp32", "onnxruntime fp32"),
    (("avx2",), False, "onnxruntime fp32", "onnxruntime fp32"),
])  # fmt: skip
def test_auto_takes_for_each_network_what_was_measured_to_be_faster(
    features: tuple[str, ...], openvino: bool, zeta: str, rho: str, machine: Callable[..., None]
) -> None:
    machine(*features, openvino=openvino)
    chosen = choose_engine("auto", threads=3)
    assert chosen.told(["zeta_tail", "rho"]) == {"zeta_tail": zeta, "rho": rho}
    assert chosen.threads == 3
    assert choose_engine("auto", threads=3) == chosen, "another choice would give other bytes for the same photo"
    assert all(
        told.endswith("fp32") for told in choose_engine("auto", precision="fp32").told(["zeta_tail", "rho"]).values()
    )


def test_what_is_asked_for_is_taken_or_refused(machine: Callable[..., None]) -> None:
    """No silent way out: a runtime or precision that cannot be had is an error."""
    machine("avx2")
    assert set(choose_engine("onnxruntime").told(["zeta_tail", "rho"]).values()) == {"onnxruntime fp32"}
    assert set(choose_engine("openvino").told(["zeta_tail", "rho"]).values()) == {"openvino fp32"}
    with pytest.raises(UsageError, match="bf16"):
        choose_engine(precision="bf16")
    machine("avx2", "avx512_bf16", openvino=False)
    with pytest.raises(UsageError, match="not installed"):
        choose_engine("openvino")
    with pytest.raises(UsageError, match="bf16"):
        choose_engine(precision="bf16")


def test_openvino_computes_the_same(folder: Path) -> None:
    """Two sizes, one not square, as the shapes are dynamic."""
    pytest.importorskip("openvino")
    rng = np.random.default_rng(0)
    with (
        open_network("one", engine(folder)) as plain,
        open_network("one", Engine("openvino", "fp32", 1, folder)) as other,
    ):
        for shape in ((1, 48, 48), (1, 72, 56), (1, 48, 48)):
            maps = rng.uniform(-1, 1, shape).astype(np.float32)
            np.testing.assert_allclose(other.run(maps), plain.run(maps), atol=1e-4)


@pytest.fixture
def plain(tmp_path: Path) -> Engine:
    nets = {name: toy_net(name, ["a"], ["x"], seed=seed) for seed, name in enumerate(("one", "two", "three"))}
    return Engine(threads=1, folder=write_models(tmp_path, nets))


def test_a_network_loaded_ahead_is_the_same_and_is_loaded_once(plain: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is opened a second time, or was not asked for, is loaded as ever."""
    maps = np.random.default_rng(1).random((1, 48, 48), np.float32)
    with open_network("one", plain) as network:
        expected = network.run(maps)
    loaded: list[str] = []

    def spied(name: str, engine: Engine) -> networks.Loaded:
        if threading.current_thread() is not threading.main_thread():
            loaded.append(name)
        return load_network(name, engine)

    monkeypatch.setattr(networks, "load_network", spied)
    with loading_ahead(("one", "two"), plain) as engine:
        assert engine == plain, "what runs does not depend on when it was loaded"
        for name in ("one", "one", "three"):
            with open_network(name, engine) as network:
                assert network.engine == plain.of(name)
                assert (network.run(maps) == expected).all() == (name == "one")
    assert loaded[0] == "one" and loaded.count("one") == 1 and "three" not in loaded


def test_a_fault_shows_where_the_network_is_opened(plain: Engine) -> None:
    """Not in the thread, where nobody would see it, and not where another network is opened."""
    (plain.folder / "two.onnx").write_bytes(b"broken")
    with loading_ahead(("two", "one"), plain) as engine:
        with open_network("one", engine):
            pass
        with pytest.raises(ModelFault, match="sha256"), open_network("two", engine):
            pass


def test_what_nobody_takes_does_not_outlive_the_block(plain: Engine) -> None:
    """A run that ends early, or whose stages were kept, must not go on loading."""
    with pytest.raises(KeyError), loading_ahead(("one", "two", "three"), plain) as engine:
        raise KeyError
    assert engine.ahead is not None and engine.ahead.take("three") is None
    with open_network("three", engine) as network:
        assert network.name == "three", "after the block networks load as ever"
