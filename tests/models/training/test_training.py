"""Batches that mean what they say, and runs that go on where they stopped."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from models.colour import linear  # noqa: E402
from models.lightstage.skin.subject import Subject  # noqa: E402
from models.lightstage.split import HELD_OUT, TRAIN, subject_part  # noqa: E402
from models.lightstage.tones import TONES, tone  # noqa: E402
from models.training.albedo import DeltaTask, log_light, unlit  # noqa: E402
from models.training.average import main as average  # noqa: E402
from models.training.average import mean_of  # noqa: E402
from models.training.capture import WHOLE, Recipe, Sitting, Studio, capture  # noqa: E402
from models.training.degrade import (  # noqa: E402
    GRADED,
    LAMPS,
    TINTED,
    blur,
    graded,
    half_mirrored,
    lost_detail,
    noisy,
    tinted,
)
from models.training.factory import main as draw_captures  # noqa: E402
from models.training.factory import seeds_of  # noqa: E402
from models.training.normals import NormalTask, angles, misplaced_pigment  # noqa: E402
from models.training.reflectance import local_strength  # noqa: E402
from models.training.specular_albedo import PsiTask, octaves, of_usual_gloss, retoned, strength_error  # noqa: E402
from models.training.store import Patches, Wholes  # noqa: E402
from models.training.super_resolution import ZetaTask  # noqa: E402
from models.training.tasks import Crop, crop_of, enlarged, psnr  # noqa: E402
from models.training.train import TASKS, go  # noqa: E402
from models.training.trainer import Run, Trainer, widened  # noqa: E402
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


def test_a_crop_knows_its_place_on_the_chart(data: Path) -> None:
    """Beards would be painted on foreheads."""
    patches = Patches(data / TRAIN, ("albedo", "geometry", "mask"))
    patches.refresh()
    plain, mirrored = (crop_of(patches.items[0], Crop(64, 136, 256, flip)) for flip in (False, True))
    ends = torch.tensor([(1024 + 136) / 6144, (512 + 64) / 4096, (1024 + 392) / 6144, (512 + 320) / 4096])
    assert torch.allclose(plain["place"], ends)
    assert torch.allclose(mirrored["place"], ends[[2, 1, 0, 3]])


def test_captures_without_a_whole_chart_are_for_patches_alone(data: Path, tmp_path: Path) -> None:
    """Drawn for psi into the same folder, they must not stop the context's training."""
    with np.load(data / TRAIN / "1_neutral.npz") as file:
        patches_alone = {name: file[name] for name in file.files if not name.startswith("whole_")}
    np.savez(tmp_path / "3_neutral.npz", allow_pickle=False, **patches_alone)
    with pytest.raises(ModelFault, match="no captures"):
        Wholes(tmp_path).refresh()
    (tmp_path / "1_neutral.npz").write_bytes((data / TRAIN / "1_neutral.npz").read_bytes())
    charts = Wholes(tmp_path)
    charts.refresh()
    assert len(charts.items) == 1


def test_a_factory_that_is_to_draw_nothing_says_so(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="nothing to draw"):
        draw_captures(str(tmp_path), whole_only=True, patches_only=True)


def test_light_out_and_in_again() -> None:
    """log_light and unlit are inverse for light up to a factor of e^4, at which unlit stops, and finite in black."""
    generator = torch.Generator().manual_seed(0)
    albedo, texture = (torch.rand(1, 3, 8, 8, generator=generator) * 0.7 + 0.2 for _ in range(2))
    assert torch.allclose(unlit(texture, log_light(texture, albedo)), albedo, atol=1e-4)
    black = unlit(torch.zeros(1, 3, 2, 2), log_light(torch.zeros(1, 3, 2, 2), torch.zeros(1, 3, 2, 2)))
    assert torch.isfinite(black).all()


def test_degradations_keep_what_they_should() -> None:
    image = torch.rand(2, 3, 64, 96)
    generator = torch.Generator().manual_seed(0)
    assert torch.equal(blur(image, 0.0), image)
    assert float(blur(image, 3.0).mean()) == pytest.approx(float(image.mean()), abs=2e-3)
    assert torch.allclose(lost_detail(image, torch.ones(2, 1, 1, 1), 8.0), image, atol=1e-5)
    assert noisy(image, generator).min() >= 0.0
    vector = torch.ones(1, 1, 4, 96)
    (mirrored,) = half_mirrored([vector], generator, [torch.tensor([-1.0])])
    ends = sorted([float(mirrored[0, 0, 0, 0]), float(mirrored[0, 0, 0, -1])])
    assert ends == [pytest.approx(-1.0, abs=1e-3), pytest.approx(1.0, abs=1e-3)]


def test_pigment_moves_and_hair_and_shade_do_not() -> None:
    """Colour that says nothing of relief: as strong as before, in other places; the light between both stays."""
    generator = torch.Generator().manual_seed(3)
    albedo = (0.5 + 0.05 * torch.randn(2, 3, 96, 96, generator=generator)).clamp(0.05, 0.95)
    hair = torch.zeros(2, 1, 96, 96)
    hair[:, :, :32, :32] = 1.0
    share = torch.tensor([1.0, 0.0]).view(2, 1, 1, 1)
    factor = misplaced_pigment(albedo, hair, share)
    assert torch.equal(factor[1], torch.ones_like(factor[1]))
    assert torch.equal(factor[0, :, :32, :32], torch.ones(3, 32, 32))
    middle = (slice(None), slice(36, 60), slice(36, 60))
    before, after = (torch.log(linear(albedo)[0] * f)[middle] for f in (1.0, factor[0]))
    before, after = before - before.mean(), after - after.mean()
    assert float(after.std() / before.std()) == pytest.approx(1.0, abs=0.1)
    assert abs(float((before * after).mean() / (before.std() * after.std()))) < 0.15


def test_coloured_lamps_change_the_hue_and_not_the_strength() -> None:
    """Of some charts, all texels alike; black stays black, and what a channel cannot show is cut off."""
    texture = torch.full((600, 3, 4, 6), 0.5)
    shown = tinted(texture, torch.Generator().manual_seed(3))
    changed = (shown != texture).flatten(1).any(1)
    assert float(changed.float().mean()) == pytest.approx(TINTED, abs=0.07)
    colour = (linear(shown[changed]) / linear(texture[changed])).log()
    assert float(colour.flatten(2).std(2).max()) < 1e-4 and float(colour.mean(1).abs().max()) < 1e-4
    assert float(colour[:, :, 0, 0].std()) == pytest.approx(LAMPS * (2 / 3) ** 0.5, rel=0.15)
    assert not tinted(torch.zeros(9, 3, 4, 6), torch.Generator()).any()
    assert float(tinted(torch.ones(9, 3, 4, 6), torch.Generator()).max()) <= 1.0


def test_some_photos_have_another_tone_curve_and_all_stay_codes() -> None:
    """Black stays black; a curve is the same on all of a chart, so equal codes stay equal."""
    texture = torch.linspace(0.0, 1.0, 48).view(1, 1, 1, 48).expand(200, 3, 4, 48).contiguous()
    shown = graded(texture, torch.Generator().manual_seed(1))
    assert float(shown.min()) == 0.0 and float(shown.max()) <= 1.0 + 1e-6
    assert float(shown.diff(dim=3).min()) >= -1e-6, "brighter stays brighter"
    changed = (shown - texture).abs().amax((1, 2, 3)) > 1e-3
    assert float(changed.float().mean()) == pytest.approx(GRADED, abs=0.1)
    assert torch.equal(shown[..., 0, :], shown[..., 3, :])


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


def test_zeta_pairs_belong_together(data: Path) -> None:
    """The large patch made small again is the small one, but for the noise and blur of a fitted texture."""
    task = ZetaTask(data)
    task.refresh()
    batch = task.held_out()[0]
    again = torch.nn.functional.interpolate(batch["large"], scale_factor=1 / 8, mode="area")
    assert 0.0 < float((again - batch["small"]).abs().mean()) < 0.02
    assert not batch["noise"].any() and task.held_out()[-1]["noise"].any()


def test_delta_sees_detail_that_its_target_has(data: Path) -> None:
    """Texture and albedo lose the same share of detail, so that delta neither blurs nor invents."""
    task = DeltaTask(data)
    task.refresh()
    batch = task.batch(2, torch.Generator().manual_seed(1))
    assert batch["texture"].shape == batch["albedo"].shape == (2, 3, 256, 256)
    assert batch["context"].shape == (2, 3, 256, 256) and torch.isfinite(batch["context"]).all()


def test_no_captures_is_said(tmp_path: Path) -> None:
    with pytest.raises(ModelFault, match=r"models\.training\.factory"):
        Wholes(tmp_path).refresh()


def test_a_capture_of_an_older_version_is_named(tmp_path: Path, data: Path) -> None:
    """One without the light on the whites would train the context on whites that follow from nothing."""
    with np.load(next((data / TRAIN).iterdir())) as file:
        np.savez(tmp_path / "3_neutral.npz", **{n: file[n] for n in file.files if n != "whole_whites"})
    with pytest.raises(ModelFault, match=r"3_neutral\.npz has no whole_whites"):
        Wholes(tmp_path).refresh()


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


def test_a_kernel_with_a_new_last_input_gives_what_it_gave() -> None:
    """Whatever the new input holds; other tensors, and kernels with more inputs than asked for, stay as they are."""
    old = torch.nn.Conv2d(3, 4, 3)
    x = torch.rand(2, 4, 9, 9)
    kernel = widened(old.weight.detach(), torch.Size((4, 4, 3, 3)))
    torch.testing.assert_close(torch.nn.functional.conv2d(x, kernel, old.bias), old(x[:, :3]))
    assert widened(kernel, torch.Size((4, 3, 3, 3))) is kernel
    assert old.bias is not None and widened(old.bias, torch.Size((9,))) is old.bias


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


def test_crops_for_psi_change_their_tone_and_stay_colours() -> None:
    """Darker and lighter; darker loses more blue than red, as melanin does; black and white stay in range."""
    skin = torch.tensor([0.75, 0.6, 0.5]).view(1, 3, 1, 1).expand(400, 3, 4, 4)
    made = retoned(skin, torch.Generator().manual_seed(7))
    assert 0.4 < float((made[:, 0, 0, 0] < skin[:, 0, 0, 0]).float().mean()) < 0.6
    assert float(made[:, 0, 0, 0].std()) > 0.05
    darker = made[(made[:, 0] < 0.7).all((1, 2))]
    assert len(darker) and (darker[:, 2] / darker[:, 0] < 0.5 / 0.75).all()
    for level in (0.0, 1.0):
        extreme = retoned(torch.full((50, 3, 2, 2), level), torch.Generator().manual_seed(8))
        assert extreme.isfinite().all() and extreme.min() >= 0.0 and extreme.max() <= 1.0


def test_detail_of_gloss_is_asked_for_octave_by_octave() -> None:
    """Dots as strong as mottles of several texels are not the same; the same detail in other places is."""
    noise = torch.randn(1, 1, 128, 128, generator=torch.Generator().manual_seed(9))
    dots, mottles = noise - blur(noise, 1.0), blur(noise, 4.0) - blur(noise, 8.0)
    dots, mottles = (0.1 * x / x.std() for x in (dots, mottles))
    assert torch.allclose(sum(octaves(mottles)) + blur(mottles, 8.0), mottles, atol=1e-5)
    weight = torch.ones(1, 1, 128, 128)
    elsewhere = mottles.roll((37, 53), (2, 3))
    assert float(strength_error(mottles, mottles, weight)) == 0.0
    assert float(strength_error(elsewhere, mottles, weight)) < 0.3 * float(strength_error(dots, mottles, weight))
    nothing = torch.zeros(1, 1, 64, 64)
    assert torch.isfinite(strength_error(nothing, nothing, weight[..., :64, :64]))


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


def test_subjects_can_be_drawn_by_tone() -> None:
    """So that each class of a table has as many as it needs; a class or part that is not there is named."""
    for name, _, _ in TONES:
        seeds = list(islice(seeds_of(HELD_OUT, 1136, name), 3))
        assert seeds[0] >= 1136 and all(tone(s) == name and subject_part(s) == HELD_OUT for s in seeds)
    assert {tone(s) for s in islice(seeds_of(TRAIN), 40)} == {name for name, _, _ in TONES}
    with pytest.raises(UsageError, match=r"tone is 'blue'.*dark, brown, tan, light"):
        seeds_of(TRAIN, tone_class="blue")
    with pytest.raises(UsageError, match="part is 'test'"):
        seeds_of("test")
