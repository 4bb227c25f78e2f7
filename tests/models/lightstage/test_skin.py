"""A subject's maps: crops, seeds, resolutions, ranges, and the physics that ties them together."""

import dataclasses
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import pytest

torch = pytest.importorskip("torch")
if TYPE_CHECKING:
    from torch import Tensor

from models.lightstage.measures import band, band_rms, correlation, log_luminance  # noqa: E402
from models.lightstage.skin import Anatomy, Atlas, ChartWindow, Skin, SkinMaps, Subject  # noqa: E402
from models.lightstage.skin.wrinkles import activation  # noqa: E402

pytestmark = pytest.mark.train

WINDOW = ChartWindow(2900, 1900, 160, 128)


@lru_cache(maxsize=4)
def cheek(seed: int) -> Skin:
    anatomy = Anatomy.uniform(Atlas.flat(14.0), face=1.0, cheek=0.6)
    return Skin.of(Subject.sample(seed), anatomy)


@lru_cache(maxsize=4)
def maps(seed: int) -> SkinMaps:
    return cheek(seed).maps(WINDOW)


def fields(m: SkinMaps) -> dict[str, "Tensor"]:
    return {f.name: getattr(m, f.name) for f in dataclasses.fields(m)}


def test_a_crop_equals_the_whole_to_the_bit() -> None:
    part = ChartWindow(2971, 1937, 47, 53)
    small = fields(cheek(3).maps(part))
    for name, whole in fields(maps(3)).items():
        assert torch.equal(small[name], part.cut(whole, WINDOW)), name


def test_the_same_seed_gives_the_same_bits() -> None:
    again = Skin.of(Subject.sample(3), Anatomy.uniform(Atlas.flat(14.0), face=1.0, cheek=0.6)).maps(WINDOW)
    for name, first in fields(maps(3)).items():
        assert torch.equal(fields(again)[name], first), name


def test_other_seeds_give_other_skin() -> None:
    assert not torch.equal(maps(3).height_mm, maps(4).height_mm)


@pytest.mark.parametrize("seed", [3, 4])
def test_maps_are_finite_and_in_range(seed: int) -> None:
    m = maps(seed)
    for name, value in fields(m).items():
        assert torch.isfinite(value).all(), name
        assert value.dtype == torch.float32
    assert m.diffuse_albedo.min() >= 0
    assert m.diffuse_albedo.max() <= 1
    assert m.specular_albedo.min() > 0.02
    assert m.specular_albedo.max() < 1
    for normal in (m.specular_normal, m.diffuse_normal):
        assert torch.allclose(normal.square().sum(0), torch.ones(128, 160), atol=1e-4)
        assert normal[2].min() > 0


def test_normals_belong_to_the_height() -> None:
    """A pit's right wall leans left: its normal points towards smaller u. Would break: handedness."""
    m = maps(3)
    h, n = m.height_mm[0], m.specular_normal
    du = (h[:, 2:] - h[:, :-2])[1:-1] / 2 * 14.0
    dv = -(h[2:] - h[:-2])[:, 1:-1] / 2 * 14.0
    inner = (slice(1, -1), slice(1, -1))
    slope_u, slope_v = -n[0][inner] / n[2][inner], -n[1][inner] / n[2][inner]
    assert correlation(du.double().numpy(), slope_u.double().numpy()) > 0.95
    assert correlation(dv.double().numpy(), slope_v.double().numpy()) > 0.95


def test_diffuse_normals_are_flatter() -> None:
    m = maps(3)
    sharp, soft = (torch.acos(n[2].clamp(-1, 1)).mean() for n in (m.specular_normal, m.diffuse_normal))
    assert 0.1 < float(soft / sharp) < 0.6


@pytest.mark.slow
def test_colour_follows_height_but_not_slavishly() -> None:
    """Correlation of high-passed albedo with depth lies in [-0.7, -0.2] for nearly all (method 1.5)."""
    values, tilts = [], []
    for seed in range(40, 56):
        m = cheek(seed).maps(ChartWindow(2900, 1900, 256, 256))
        albedo = log_luminance(m.diffuse_albedo.permute(1, 2, 0).double().numpy())
        depth = -m.height_mm[0].double().numpy()
        values.append(correlation(band(albedo, 14.0, 0.15, 1.5), band(depth, 14.0, 0.15, 1.5)))
        tilts.append(float(torch.rad2deg(torch.acos(m.specular_normal[2].clamp(-1, 1))).mean()))
    inside = [-0.7 <= v <= -0.2 for v in values]
    assert np.mean(inside) > 0.7
    assert max(values) < 0.0
    assert np.mean([4.5 <= t <= 13.0 for t in tilts]) > 0.85
    assert np.std(values) > 0.05  # the law varies between subjects


@pytest.mark.parametrize("seed", [3, 4])
def test_specular_albedo_varies_less_the_finer(seed: int) -> None:
    """Pores that hid most of themselves from the light made its finest band the strongest."""
    gloss = np.log(maps(seed).specular_albedo[0].double().numpy())
    fine, middle, coarse = (band_rms(gloss, 14.0, *limits) for limits in ((0.15, 0.4), (0.4, 0.8), (0.8, 1.6)))
    assert 0.005 < fine < middle < coarse


def test_low_resolution_is_the_mean_of_high() -> None:
    """The same skin at a quarter of the size: colours agree with the averaged full map."""
    high = cheek(3).maps(ChartWindow(2880, 1920, 384, 256)).diffuse_albedo
    low = cheek(3).maps(ChartWindow(720, 480, 96, 64, 1536, 1024)).diffuse_albedo
    mean = torch.nn.functional.avg_pool2d(high[None], 4)[0]
    assert float((low - mean).abs().mean() / mean.mean()) < 0.04


def test_subject_survives_json() -> None:
    subject = Subject.sample(17)
    assert Subject.from_json(subject.to_json()) == subject


def test_tone_is_uniform() -> None:
    angles = np.sort([Subject.sample(s).tone.typology_angle_deg for s in range(400)])
    expected = np.linspace(-60, 65, 400)
    assert np.abs(angles - expected).max() < 125 * 1.63 / 20  # Kolmogorov-Smirnov at 1 %


def test_smiling_deepens_the_folds_of_its_own_side() -> None:
    smile = {"mouthSmileLeft": 1.0}
    assert activation(smile, "nasolabial", 1) > 0.5
    assert activation(smile, "nasolabial", -1) == 0.0
    assert activation({"browInnerUp": 1.0}, "forehead", 0) == 1.0
    assert activation({"browInnerUp": 1.0}, "crow", 1) == 0.0


@pytest.mark.slow
def test_expressions_move_wrinkles_on_the_head() -> None:
    from models.lightstage.stage import Stage

    stage = Stage.open()
    window = stage.window(0.0, stage.places()["forehead"][1], 256)
    calm, raised = (stage.skin(21, pose).draw(window) for pose in ("neutral", "surprise"))
    assert raised.folds.mean() > 1.5 * calm.folds.mean()
    assert torch.equal(calm.spots.melanin, raised.spots.melanin)  # freckles stay where they are


@pytest.mark.slow
def test_a_small_map_shows_as_much_brow_as_a_large_one() -> None:
    """Would break: strands thinner than a texel lost, so that brows turn pale in the texture that networks see."""
    from models.lightstage.stage import Stage

    stage = Stage.open()
    skin, place = stage.skin(1034), stage.places()["brow"]
    large, small = skin.maps(stage.window(*place, 512)), skin.maps(stage.window(*place, 128, 1536))
    assert float(small.regions[1].mean()) == pytest.approx(float(large.regions[1].mean()), rel=0.12)
    for a, b in zip(large.diffuse_albedo.mean((1, 2)), small.diffuse_albedo.mean((1, 2)), strict=True):
        assert float(b) == pytest.approx(float(a), rel=0.03)
