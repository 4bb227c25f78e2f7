"""Networks loaded before they are needed: the same ones, each once, and their faults where they are opened."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from service.errors import ModelFault
from service.runtime import networks
from service.runtime.networks import Engine, load, loading_ahead, open_network
from tests.service.runtime.toynets import toy_net, write_models


@pytest.fixture
def plain(tmp_path: Path) -> Engine:
    nets = {name: toy_net(name, ["a"], ["x"], seed=seed) for seed, name in enumerate(("one", "two", "three"))}
    return Engine(threads=1, folder=write_models(tmp_path, nets))


def test_a_network_loaded_ahead_is_the_same_and_is_loaded_once(plain: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is opened a second time, or was not asked for, is loaded as ever."""
    maps = np.random.default_rng(1).random((1, 16, 16), np.float32)
    with open_network("one", plain) as network:
        expected = network.run(maps)
    loaded: list[str] = []

    def spied(name: str, engine: Engine) -> networks.Loaded:
        if threading.current_thread() is not threading.main_thread():
            loaded.append(name)
        return load(name, engine)

    monkeypatch.setattr(networks, "load", spied)
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
