"""Batches that mean what they say, and runs that go on where they stopped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from models.lightstage.skin.subject import Subject  # noqa: E402
from models.lightstage.split import TRAIN, subject_part  # noqa: E402
from models.training.albedo import log_light, unlit  # noqa: E402
from models.training.average import main as average  # noqa: E402
from models.training.average import mean_of  # noqa: E402
from models.training.capture import WHOLE, Recipe, Sitting, Studio, capture  # noqa: E402
from models.training.normals import NormalTask, angles  # noqa: E402
from models.training.reflectance import local_strength  # noqa: E402
from models.training.specular_albedo import PsiTask, of_usual_gloss  # noqa: E402
from models.training.store import Patches  # noqa: E402
from models.training.tasks import Crop, crop_of, enlarged, psnr  # noqa: E402
from models.training.train import TASKS, go  # noqa: E402
from models.training.trainer import Run, Trainer  # noqa: E402
from service.errors import ModelFault, UsageError  # noqa: E402
from service.runtime.network_registry import GEOMETRY  # noqa: E402

pytestmark = pytest.mark.train


def test_a_crop_of_geometry_is_that_part_of_the_whole(data: Path) -> None:
    """A crop cut before enlarging would otherwise be shifted by a fraction of a cell."""
    patches = Patches(data / TRAIN, ("geometry", "mask"))
    patches.refresh()
    item = patches.items[0]
    whole = enlarged(item["geometry"], 8, Crop(0, 0, 512, False))
    part = enlarged(item["geometry"], 8, Crop(64, 136, 256, False))
    assert torch.allclose(part, whole[:, 64:320, 136:392], atol=1e-5)


def test_a_mirrored_crop_turns_x_around(data: Path) -> None:
    """Pores would turn to bumps on one side of the face."""
    patches = Patches(data / TRAIN, ("specular_normal", "geometry", "mask"))
    patches.refresh()
    plain, mirrored = (crop_of(patches.items[0], Crop(0, 0, 512, flip)) for flip in (False, True))
    back = mirrored["specular_normal"].flip(-1) * torch.tensor([-1.0, 1.0, 1.0]).view(3, 1, 1)
    assert torch.allclose(back, plain["specular_normal"])
    x, y = GEOMETRY.index("normal_object_x"), GEOMETRY.index("normal_object_y")
    assert torch.allclose(mirrored["geometry"][x].flip(-1), -plain["geometry"][x])
    assert torch.allclose(mirrored["geometry"][y].flip(-1), plain["geometry"][y])


def test_light_out_and_in_again() -> None:
    """log_light and unlit are inverse for light up to a factor of e^4, at which unlit stops, and finite in black."""
    generator = torch.Generator().manual_seed(0)
    albedo, texture = (torch.rand(1, 3, 8, 8, generator=generator) * 0.7 + 0.2 for _ in range(2))
    assert torch.allclose(unlit(texture, log_light(texture, albedo)), albedo, atol=1e-4)
    black = unlit(torch.zeros(1, 3, 2, 2), log_light(torch.zeros(1, 3, 2, 2), torch.zeros(1, 3, 2, 2)))
    assert torch.isfinite(black).all()


def test_measures_against_closed_forms() -> None:
    """10 degrees are 10 degrees, also where the cosine is flat; an error of 0.1 is 20 dB."""
    up = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
    for degrees in (0.0, 0.01, 10.0, 170.0):
        a = np.radians(degrees)
        tilted = torch.tensor([np.sin(a), 0.0, np.cos(a)], dtype=torch.float32).view(1, 3, 1, 1)
        assert float(angles(tilted, up)) == pytest.approx(degrees, abs=2e-3)
    one = torch.ones(1, 3, 4, 4)
    assert psnr(one * 0.5, one * 0.6, one[:, :1]) == pytest.approx(20.0, abs=1e-3)
    assert psnr(one, one, one[:, :1] * 0.0) == 99.0
    assert float(local_strength(torch.full((1, 2, 64, 64), 0.3)).mean()) == pytest.approx(0.3 * 2**0.5, abs=1e-3)


@pytest.mark.parametrize("network", sorted(TASKS))
def test_every_network_takes_a_step(network: str, data: Path) -> None:
    """And its loss is finite, with the discriminator too."""
    task = TASKS[network](data, 64)
    task.refresh()
    weight = 0.01 if network == "zeta" else 0.0
    trainer = Trainer(Run(network, "slim", 2, 2, 64, 1e-3, 0, 0.0, weight), task, "cpu")
    before = [p.detach().clone() for p in trainer.network.parameters()]
    losses = trainer.train_step()
    assert all(np.isfinite(value) for value in losses.values())
    assert ("matching" in losses) == (network == "zeta")
    assert any(not torch.equal(a, b) for a, b in zip(before, trainer.network.parameters(), strict=True))


def test_a_run_goes_on_where_it_stopped(data: Path, tmp_path: Path) -> None:
    """Two steps at once, and one step, a restart and another step, end with the same weights."""
    run = Run("psi", "slim", 2, 2, 64, 1e-3, 0, 0.0, 0.0)

    def trainer() -> Trainer:
        task = TASKS["psi"](data, 64)
        task.refresh()
        return Trainer(run, task, "cpu")

    (tmp_path / "once").mkdir()
    whole = trainer()
    go(whole, tmp_path / "once", 10, 10.0)
    (tmp_path / "twice").mkdir()
    first = trainer()
    first.train_step()
    first.save(tmp_path / "twice")
    second = trainer()
    second.load(tmp_path / "twice")
    assert second.step == 1
    go(second, tmp_path / "twice", 10, 10.0)
    pairs = zip(whole.average.parameters(), second.average.parameters(), strict=True)
    assert all(torch.allclose(a, b, atol=1e-7) for a, b in pairs)
    assert (tmp_path / "twice" / "log.jsonl").read_text().count("\n") == 1
    other = Trainer(Run("rho", "slim", 2, 2, 64, 1e-3, 0, 0.0, 0.0), NormalTask(data, "specular_normal", 64), "cpu")
    with pytest.raises(ModelFault, match="psi"):
        other.load(tmp_path / "twice")


def test_a_run_begins_with_the_weights_of_another(data: Path, tmp_path: Path) -> None:
    """With its average, at step 0; what does not fit stays as it was made, and another network is refused."""

    def trainer(config: str = "slim") -> Trainer:
        return Trainer(Run("psi", config, 2, 2, 64, 1e-3, 0, 0.0, 0.0), TASKS["psi"](data, 64), "cpu")

    first = trainer()
    with torch.no_grad():
        for weights in first.average.parameters():
            weights.fill_(0.25)
    first.step = 7
    first.save(tmp_path)
    second = trainer()
    assert second.begin_with(tmp_path) == [] and second.step == 0
    assert all(bool((p == 0.25).all()) for p in (*second.network.parameters(), *second.average.parameters()))
    wider = trainer("wide")
    before = {name: p.clone() for name, p in wider.network.named_parameters()}
    fresh = wider.begin_with(tmp_path)
    assert fresh and all(torch.equal(before[name], dict(wider.network.named_parameters())[name]) for name in fresh)
    other = Trainer(Run("rho", "slim", 2, 2, 64, 1e-3, 0, 0.0, 0.0), NormalTask(data, "specular_normal", 64), "cpu")
    with pytest.raises(ModelFault, match="psi"):
        other.begin_with(tmp_path)


def test_the_mean_of_two_runs_is_a_run(data: Path, tmp_path: Path) -> None:
    """It can be measured and gone on with; runs of different networks have no mean."""
    for value in (0.25, 0.75):
        trainer = Trainer(Run("psi", "slim", 2, 2, 64, 1e-3, 0, 0.0, 0.0), TASKS["psi"](data, 64), "cpu")
        with torch.no_grad():
            for weights in trainer.average.parameters():
                weights.fill_(value)
        (tmp_path / str(value)).mkdir()
        trainer.save(tmp_path / str(value))
    both = [tmp_path / "0.25", tmp_path / "0.75"]
    average(both, tmp_path / "mean", data)
    made = torch.load(tmp_path / "mean" / "checkpoint.pt", weights_only=True)
    assert all(bool((w == 0.5).all()) for w in made["average"].values() if w.is_floating_point())
    assert '"mean_of": 2' in (tmp_path / "mean" / "log.jsonl").read_text()
    with pytest.raises(UsageError, match="two or more"):
        average(both[:1], tmp_path / "none", data)
    with pytest.raises(ModelFault, match="different networks"):
        mean_of([{"a": torch.zeros(2)}, {"a": torch.zeros(3)}])
    assert not (tmp_path / "none").exists()


@pytest.mark.slow
def test_a_real_capture() -> None:
    """Drawn by the light stage: texture is albedo under light, normals are small angles, nothing is missing."""
    seed = next(s for s in range(1000, 1100) if subject_part(s) == TRAIN)
    sitting = Sitting.of(Studio.open(), seed, "neutral", TRAIN)
    arrays = capture(sitting, Recipe(lights=1, patch=128, block=1, lit=1, draft_width=0))
    assert int(arrays["patches"]) == 1
    assert arrays["whole_texture"].shape == (1, 3, WHOLE[1], WHOLE[0])
    assert arrays["whole_whites"].shape == (1, 2, 3) and np.abs(arrays["whole_whites"]).max() < 4.0
    assert arrays["patch0_albedo"].std() > 0 and "patch0_texture" in arrays
    assert np.abs(arrays["patch0_specular_normal"].astype(np.int32)).mean() < 0.3 * 32767
    unlit_arrays = capture(sitting, Recipe(lights=0, patch=128, block=1, lit=0, draft_width=1536))
    assert int(unlit_arrays["patches"]) == 2
    assert not any(name.startswith("whole_") or name.endswith("_texture") for name in unlit_arrays)
    assert np.array_equal(unlit_arrays["patch0_specular"], arrays["patch0_specular"])


def test_psi_is_not_asked_how_glossy_a_subject_is(data: Path) -> None:
    """Two subjects who differ in gloss alone train it on one map; what is measured keeps their own."""
    subjects = [Subject.sample(seed) for seed in range(1000, 1040)]
    dull, shiny = (pick(range(40), key=lambda i: subjects[i].gloss.scale) for pick in (min, max))
    level = np.array([[[0.3, 0.6]]], np.float32)
    shown = [
        {"seed": np.array(1000 + i), "specular": np.rint(255 * level * subjects[i].gloss.scale).astype(np.uint8)}
        for i in (dull, shiny)
    ]
    assert np.ptp([item["specular"] for item in shown], axis=0).min() > 10
    made = [of_usual_gloss(item)["specular"].astype(int) for item in shown]
    assert np.abs(made[0] - made[1]).max() <= 1 and np.abs(made[0] - 255 * level).max() <= 1.5
    white = of_usual_gloss({"seed": np.array(1000 + dull), "specular": np.full((1, 2, 2), 255, np.uint8)})
    assert white["specular"].min() == 255
    task = PsiTask(data, 64)
    task.refresh()
    once = [item["specular"].copy() for item in task.train.items]
    task.refresh()
    assert all(np.array_equal(a["specular"], b) for a, b in zip(task.train.items, once, strict=True))
