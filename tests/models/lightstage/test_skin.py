"""A subject's maps: crops, seeds, resolutions, ranges, and the physics that ties them together."""

import dataclasses
from functools import lru_cache
from typing import TYPE_CHECKING

import pytest

torch = pytest.importorskip("torch")
if TYPE_CHECKING:
    from torch import Tensor

from models.lightstage.measures import correlation  # noqa: E402
from models.lightstage.skin import Anatomy, Atlas, ChartWindow, Skin, SkinMaps, Subject  # noqa: E402

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
