"""The measure of the context on real skin: a network that is right, and one that finds too much light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from benchmarks.real_albedo import BRIGHT, RealSkin, judged, lit, table  # noqa: E402
from models.colour import linear  # noqa: E402
from models.networks.context import HEIGHT, WIDTH  # noqa: E402
from models.training.albedo import log_light  # noqa: E402
from models.training.context import ContextTask  # noqa: E402
from models.training.store import Arrays  # noqa: E402

pytestmark = pytest.mark.train


@pytest.fixture
def task(tmp_path: Path) -> ContextTask:
    """One capture under two lights, brighter to the right."""
    task = ContextTask(tmp_path)
    ramp = np.broadcast_to(np.linspace(60, 180, WIDTH), (2, 3, HEIGHT, WIDTH)).astype(np.uint8)
    geometry = np.ones((11, HEIGHT, WIDTH), np.float16)
    albedo = np.full((3, HEIGHT, WIDTH), 128, np.uint8)
    whites = np.zeros((len(ramp), 2, 3), np.float32)
    item: Arrays = {"albedo": albedo, "texture": ramp, "geometry": geometry, "whites": whites, "seed": np.array(1)}
    task.test.items.append(item)
    return task


def test_a_right_network_is_right_and_a_bright_light_is_dark_skin(
    task: ContextTask, monkeypatch: pytest.MonkeyPatch
) -> None:
    skin = RealSkin(torch.full((1, 3, HEIGHT, WIDTH), 0.7), *2 * [torch.ones(1, 1, HEIGHT, WIDTH)])
    (batch,) = lit(task, skin, torch.Generator().manual_seed(1))
    shown = linear(batch["texture"]).mean(1)
    assert float(torch.quantile(shown, BRIGHT[0])) == pytest.approx(BRIGHT[1], rel=0.02), "exposed as a photo is"
    true = log_light(batch["clean"], batch["albedo"])
    found = {}
    for off in (0.0, 0.3):
        monkeypatch.setattr(task, "predict", lambda network, batch, off=off: true + off)
        found[off] = judged(task, torch.nn.Identity(), batch, skin.face)
    assert found[0.0][0] > 45
    assert found[0.0][3] == pytest.approx(0, abs=1e-5)
    assert found[0.3][3] == pytest.approx(0.3, abs=1e-5)
    assert found[0.3][0] < 25 < 45 < found[0.3][2]


def test_the_table_ends_with_the_mean_of_all() -> None:
    lines = table({"a": np.array([[20.0, 18.0, 22.0, 0.2]]), "b": np.array([[22.0, 20.0, 24.0, 0.0]])})
    assert lines[-1] == "| all | 21.0 | 19.0 | 23.0 | +0.10 +- 0.10 |"
