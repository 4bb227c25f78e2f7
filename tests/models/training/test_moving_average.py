"""The moving average starts near the network and then lags behind it."""

import pytest

torch = pytest.importorskip("torch", reason="torch is missing: make test-train installs it")

from models.training.moving_average import MOST, follow  # noqa: E402

pytestmark = pytest.mark.train


@pytest.mark.parametrize(("step", "kept"), [(0, 0.1), (90, 0.91), (10**6, MOST)])
def test_a_step_keeps_its_share(step: int, kept: float) -> None:
    network, average = torch.nn.Linear(1, 1, bias=False), torch.nn.Linear(1, 1, bias=False)
    torch.nn.init.constant_(network.weight, 1.0)
    torch.nn.init.constant_(average.weight, 0.0)
    follow(average, network, step)
    assert float(average.weight.detach()) == pytest.approx(1 - kept, rel=1e-4)
