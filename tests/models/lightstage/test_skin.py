"""A subject's maps: crops, seeds, resolutions, ranges, and the physics that ties them together."""

import dataclasses
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import pytest

torch = pytest.importorskip("torch")
if TYPE_CHECKING:
    from torch import Tensor

from models.lightstage.measures import band, correlation, log_luminance  # noqa: E402
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


def test_smiling_deepens_the_folds_of_its_own_side() -> None:
    smile = {"mouthSmileLeft": 1.0}
    assert activation(smile, "nasolabial", 1) > 0.5
    assert activation(smile, "nasolabial", -1) == 0.0
    assert activation({"browInnerUp": 1.0}, "forehead", 0) == 1.0
    assert activation({"browInnerUp": 1.0}, "crow", 1) == 0.0
