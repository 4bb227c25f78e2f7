"""Shipped weights come back as those that were trained."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

from export.networks.convert import load_run, parts_of  # noqa: E402
from models.networks.configs import NETWORKS, build  # noqa: E402
from models.training.restore import main, restored  # noqa: E402
from models.training.train import TASKS  # noqa: E402
from models.training.trainer import Run, Trainer  # noqa: E402
from service.runtime.networks import Engine, open_network  # noqa: E402

pytestmark = pytest.mark.train

SHIPPED = [name for name in NETWORKS if name != "delta_blind"]


@pytest.mark.parametrize("network", SHIPPED)
def test_the_network_is_the_one_that_ships(network: str) -> None:
    """Every weight under its own name: two of one shape that change places would go unnoticed by shapes alone."""
    module = build(network)
    module.load_state_dict(restored(network, "compact"))
    for part in parts_of(network, module.eval()):
        with open_network(part.name, Engine(threads=1)) as shipped:
            height, width = part.sizes[0]
            channels = len(shipped.description.channels)
            maps = np.random.default_rng(1).uniform(-1, 1, (1, channels, height, width)).astype(np.float32)
            expected = np.asarray(shipped._compiled(maps))  # whole networks check their size before running
            with torch.no_grad():
                found = part.module(torch.from_numpy(maps)).numpy()
        assert np.abs(found - expected).max() <= 1e-4 * max(1.0, float(np.abs(expected).max()))


def test_training_goes_on_from_it(tmp_path: Path) -> None:
    """As a run of its own and as what another run begins with."""
    main("psi", tmp_path / "run", config="compact", side=64)
    network, module, facts = load_run(tmp_path / "run")
    assert network == "psi" and facts["steps_done"] > 0
    trainer = Trainer(Run("psi", "compact", 9, 1, 64, 1e-3, 0, 0.0, 0.0), TASKS["psi"](tmp_path, 64), "cpu")
    assert trainer.begin_with(tmp_path / "run") == []
    state = module.state_dict()
    assert all(torch.equal(values, state[name]) for name, values in trainer.network.state_dict().items())
