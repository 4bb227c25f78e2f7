"""One network trained by several processes: the same weights, whoever is lost on the way."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from torch import Tensor  # noqa: E402

from models.training.team import Team, samples_of  # noqa: E402
from models.training.train import TASKS, go  # noqa: E402
from models.training.trainer import Run, Trainer  # noqa: E402
from service.jobs.process import descendants  # noqa: E402
from tests.support.server import free_port  # noqa: E402

pytestmark = pytest.mark.train

STEPS, EVERY = 100, 10


def agent(folder: Path, data: Path, port: int, name: str) -> subprocess.Popen[bytes]:
    """One of the machines, as torchrun sees it."""
    rendezvous = ["--rdzv-backend", "c10d", "--rdzv-endpoint", f"127.0.0.1:{port}", "--rdzv-id", "run"]
    elastic = ["--nnodes", "1:2", "--nproc-per-node", "1", "--max-restarts", "3"]
    # The first one holds the rendezvous, and must not die; it waits so long for the other, and when that is lost.
    elastic += ["--rdzv-conf", f"is_host={name == 'first'},last_call_timeout=30"]
    train = ["psi", "--data", str(data), "--config", "slim", "-o", str(folder / "run"), "--steps", str(STEPS)]
    train += ["--batch", "1", "--side", "64", "--every", str(EVERY), "--parts", "2", "--rate", "0.001"]
    command = [sys.executable, "-m", "torch.distributed.run", *rendezvous, *elastic, "-m", "models.training.train"]
    with (folder / f"{name}.log").open("wb") as log:
        return subprocess.Popen([*command, *train], stdout=log, stderr=log)


def end(machine: subprocess.Popen[bytes]) -> None:
    """The agent and the process that trains, which has a session of its own."""
    for process in (machine.pid, *descendants(machine.pid)):
        with contextlib.suppress(OSError):
            os.kill(process, signal.SIGKILL)
    machine.wait()


def alone(data: Path, folder: Path) -> tuple[Tensor, Tensor]:
    """All weights of a run by one process, before it and after.

    With one thread, as the members have: with two the sums of a convolution are rounded otherwise, and Adam makes of a
    rounding of 1e-7 in one step 1.4 % of the way after a hundred.
    """
    torch.set_num_threads(1)
    task = TASKS["psi"](data, 64)
    task.refresh()
    run = Run("psi", "slim", STEPS, 1, 64, 1e-3, 1, 0.6, 0.0, parts=2)
    trainer = Trainer(run, task, "cpu", team=Team(shared=True))
    first = flat(trainer.average.state_dict())
    go(trainer, folder, STEPS, 1e9)
    return first, flat(trainer.average.state_dict())


def flat(weights: dict[str, Tensor]) -> Tensor:
    return torch.cat([weights[name].detach().double().flatten() for name in sorted(weights)])


@pytest.mark.slow
def test_a_machine_that_is_lost_costs_the_steps_since_the_checkpoint(data: Path, tmp_path: Path) -> None:
    """And the weights are those of a run that nothing happened to, and that one process made."""
    port, log = free_port(), tmp_path / "run" / "log.jsonl"
    agents = [agent(tmp_path, data, port, name) for name in ("first", "second")]
    try:
        deadline = time.monotonic() + 600
        while not (log.exists() and log.read_text().count("\n") >= 3) and time.monotonic() < deadline:
            assert agents[0].poll() is None, (tmp_path / "first.log").read_text()[:4000]
            time.sleep(0.05)
        end(agents[1])
        before = log.read_text().count("\n")
        assert agents[0].wait(600) == 0, (tmp_path / "first.log").read_text()[-4000:]
    finally:
        for one in agents:
            end(one)
    said = (tmp_path / "first.log").read_text()
    assert "2 at work" in said and "1 at work" in said, "there were two, and then one"
    assert before < log.read_text().count("\n") == STEPS // EVERY
    (tmp_path / "alone").mkdir()
    first, wanted = alone(data, tmp_path / "alone")
    found = torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=True)
    assert found["step"] == STEPS
    # Two parts have the same sum whoever adds them up, and a checkpoint holds all that the next step depends on.
    off = float((flat(found["average"]) - wanted).norm() / (wanted - first).norm())
    assert off < 1e-6, off


def test_members_share_all_parts_of_a_step_and_no_two_parts_are_alike() -> None:
    for size in (1, 2, 3):
        parts = [part for rank in range(size) for part in Team(rank, size).parts(7)]
        assert sorted(parts) == list(range(7))
    places = ((seed, step, part) for seed in (1, 2) for step in (0, 1) for part in (0, 1))
    drawn = {float(torch.rand(1, generator=samples_of(*place), dtype=torch.float64)) for place in places}
    assert len(drawn) == 8
