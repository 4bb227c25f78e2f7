"""What an exporter does to the weights of a reader before it writes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")

import torch

from export.networks.hair import keep
from export.networks.reader import CHI3_MEDIAN, WITHIN_ONE, calibrate
from models.networks.hair import SIZES, HairReader
from models.networks.reader import CHART_MM, Read, Reader
from models.training.hair import NOT_SHIPPED
from models.training.reader_data import Batch
from models.training.restore import weights_of
from service.errors import ModelFault
from service.runtime.sessions import MODELS

pytestmark = pytest.mark.train


def test_standard_deviations_are_stretched_to_what_people_never_seen_say(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Errors three times as large as a network says: afterwards as many lie within one as a normal distribution has."""
    rng, side = np.random.default_rng(0), 64
    said_mm, said_sine, times = 2.0, 0.05, 3.0
    off = torch.from_numpy(rng.normal(0, times * said_mm, (4, 2, side, side)).astype(np.float32))
    turn = torch.from_numpy(rng.normal(0, times * said_sine, (4, 3, side, side)).astype(np.float32))
    scale, ones = torch.tensor(CHART_MM).view(1, 2, 1, 1), torch.ones(4, 1, side, side)
    zero = torch.zeros(4, 3, side, side)
    batch = Batch(zero, zero[:, :2], ones, zero, ones, zero, ones)
    network = Reader()
    monkeypatch.setattr(network, "read", lambda image: Read(off / scale, said_mm * ones, turn, said_sine * ones, zero))
    monkeypatch.setattr("export.networks.reader.shards", lambda data, held_out: [tmp_path])
    monkeypatch.setattr("export.networks.reader.measured_on", lambda paths, most: iter([batch]))
    assert calibrate(network, tmp_path) == pytest.approx([times, times], rel=0.03)
    within = (off.square().sum(1).sqrt() < network.spread_scale[0] * said_mm).float().mean()
    assert float(within) == pytest.approx(WITHIN_ONE, abs=0.01)
    assert pytest.approx(float(np.sqrt(np.median((rng.normal(0, 1, (200_000, 3)) ** 2).sum(1)))), 0.01) == CHI3_MEDIAN
    image = torch.rand(1, 3, 256, 256)
    plain = Reader()
    plain.load_state_dict(network.state_dict())
    assert torch.allclose(network(image)[1], network.spread_scale[0] * plain(image)[1])


def test_kept_weights_lie_between_the_run_and_what_ships() -> None:
    """All of the shipped weights is the shipped network, none changes nothing; other shares than 0 to 1 are refused."""
    network = HairReader(SIZES["broad"])
    begun = {name: values.clone() for name, values in network.state_dict().items()}
    keep(network, 0.0)
    assert all(torch.equal(values, begun[name]) for name, values in network.state_dict().items())
    keep(network, 1.0)
    shipped = weights_of(MODELS / "hair.onnx")
    for name, values in network.state_dict().items():
        if not name.startswith(NOT_SHIPPED):
            assert np.allclose(values.numpy(), shipped[name], atol=1e-6), name
    with pytest.raises(ModelFault, match=r"--keep is 1\.5"):
        keep(network, 1.5)
