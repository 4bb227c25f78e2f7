"""The reader: what comes out of it, that its truth is what the shards say, and that a run learns and goes on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: pip install '.[train]'")
pytest.importorskip("moderngl", reason="moderngl is not installed: pip install '.[train]'")

from models.networks.reader import CELL, PART_CELL, PARTS, SIDE, Reader, flops  # noqa: E402
from models.people.make import Portrait  # noqa: E402
from models.people.shards import encode, save  # noqa: E402
from models.training.reader import Run, losses  # noqa: E402
from models.training.reader_data import Batch, augmented, batch_of, read_cells, shard_seed  # noqa: E402
from service.face.reading import part_labels as labels  # noqa: E402
from service.geometry.camera import Camera  # noqa: E402
from service.hair.kinds import KINDS  # noqa: E402

pytestmark = pytest.mark.train


def made_up(seed: int) -> Portrait:
    """A portrait of a disc: chart coordinates and normals that are easy to check."""
    import cv2

    y, x = np.mgrid[:SIDE, :SIDE] + 0.5
    inside = (x - 128) ** 2 + (y - 128) ** 2 < 80**2
    chart = np.where(inside[..., None], np.stack([x / SIDE, 1 - y / SIDE], -1), np.nan).astype(np.float32)
    normal = np.where(inside[..., None], [0.0, 0.6, -0.8], 0.0).astype(np.float32)
    image = np.where(inside[..., None], np.array([200, 150, 120]), 60 + seed % 50).astype(np.uint8)
    jpeg = cv2.imencode(".jpg", image[..., ::-1])[1].tobytes()
    camera = Camera(SIDE, SIDE, 500.0, np.full(2, SIDE / 2), np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]))
    return Portrait(
        seed, image, jpeg, chart, normal, np.where(inside, 1.0, np.inf).astype(np.float32),
        np.where(inside, labels.SKIN, labels.BACKGROUND).astype(np.uint8), np.zeros((478, 2), np.float32),
        np.zeros(478, bool), camera, np.zeros(100, np.float32), np.zeros(52, np.float32), np.zeros((4, 3), np.float32),
        "open", np.zeros(2, np.float32), np.zeros((SIDE, SIDE), np.float32), np.zeros((SIDE, SIDE, 2), np.float32),
        dict.fromkeys(KINDS, ""), float("nan"),
    )  # fmt: skip


@pytest.fixture
def shard(tmp_path: Path) -> Path:
    path = tmp_path / f"people-{SIDE}-00100000-04.npz"
    save(encode([made_up(seed) for seed in range(4)]), path)
    return path


def test_the_network_stays_within_its_budget_and_says_what_it_promises() -> None:
    network = Reader().eval()
    assert flops(network) <= 3.0e9
    with torch.no_grad():
        read = network.read(torch.rand(2, 3, SIDE, SIDE))
    cells, part_cells = SIDE // CELL, SIDE // PART_CELL
    assert read.chart.shape == (2, 2, cells, cells)
    assert read.parts.shape == (2, PARTS, part_cells, part_cells)
    assert len(labels.PARTS) == PARTS
    np.testing.assert_allclose(read.normal.square().sum(1).numpy(), 1.0, atol=1e-4)
    assert (read.chart_mm > 0).all()
    assert (read.normal_sine > 0).all()


def test_cells_hold_what_their_middles_show(shard: Path) -> None:
    cells = read_cells(shard)
    assert shard_seed(shard) == 100000
    inside = cells["charted"][0]
    row, column = np.nonzero(inside)
    middle = (np.stack([column, row], -1) + 0.5) * CELL
    expected = np.stack([middle[:, 0] / SIDE, 1 - middle[:, 1] / SIDE], -1)
    np.testing.assert_allclose(cells["chart"][0][inside], expected, atol=1e-4)
    assert 0.9 < inside.sum() / (np.pi * (80 / CELL) ** 2) < 1.0
    batch = batch_of([(cells, 0)])
    seen = batch.normal[0, :, batch.shaped[0, 0] > 0].T.numpy()
    np.testing.assert_allclose(seen, np.broadcast_to([0.0, 0.6, -0.8], seen.shape), atol=0.01)
    np.testing.assert_allclose(batch.parts.sum(1).numpy(), 1.0)


def test_mirrored_truth_belongs_to_the_mirrored_picture(shard: Path) -> None:
    """The disc's chart is symmetric: mirrored or not, u grows to the right of the picture."""
    cells = read_cells(shard)
    generator = torch.Generator().manual_seed(1)
    for _ in range(4):
        batch = augmented(batch_of([(cells, i) for i in range(4)]), generator)
        where = batch.charted[:, 0] > 0
        across = ((torch.arange(SIDE // CELL) + 0.5) * CELL / SIDE).expand_as(batch.chart[:, 0])
        torch.testing.assert_close(batch.chart[:, 0][where], across[where], atol=1e-3, rtol=0.0)
        assert ((batch.image >= 0) & (batch.image <= 1)).all()


def total(run: Run, batch: Batch) -> float:
    with torch.no_grad():
        return sum(float(value) for value in losses(run.network.read(batch.image), batch).values())


def test_a_run_learns_and_goes_on(shard: Path, tmp_path: Path) -> None:
    cells = read_cells(shard)
    batch = batch_of([(cells, i) for i in range(2)])
    run = Run(tmp_path, "cpu")
    before = total(run, batch)
    for _ in range(6):
        run.train_step(batch, 1.0, False)
    assert total(run, batch) < before
    run.save()
    again = Run(tmp_path, "cpu")
    assert again.step == run.step
    for one, other in zip(run.network.parameters(), again.network.parameters(), strict=True):
        torch.testing.assert_close(one, other)
