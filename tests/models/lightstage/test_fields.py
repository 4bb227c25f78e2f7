"""Noise, blur, marks and random streams: what they promise, and that a crop equals the whole to the bit."""

from typing import TYPE_CHECKING

import numpy as np
import pytest

torch = pytest.importorskip("torch")
if TYPE_CHECKING:
    from torch import Tensor

from models.lightstage.skin.atlas import Atlas, Metric  # noqa: E402
from models.lightstage.skin.sites import scatter  # noqa: E402
from models.lightstage.skin.splat import Marks, accumulator, add, finished, stamps  # noqa: E402
from models.lightstage.skin.stack import GaussianStack  # noqa: E402
from models.lightstage.skin.streams import Stream  # noqa: E402
from models.lightstage.skin.volumes import Placement, furrows, noise  # noqa: E402
from models.lightstage.skin.window import ChartWindow  # noqa: E402

pytestmark = pytest.mark.train


@pytest.mark.parametrize("volume", [noise(1), noise(3), furrows()])
def test_volumes_are_periodic_and_continuous(volume) -> None:  # type: ignore[no-untyped-def]
    place = Placement(np.eye(3), (0.0, 0.0, 0.0))
    x = torch.linspace(0.0, 2 * volume.period, 4001)
    points = torch.stack([x, torch.full_like(x, 1.3), torch.full_like(x, 0.2)])[:, None]
    values = volume(points, 1.0, place)[:2, 0]
    half = len(x) // 2
    assert torch.allclose(values[:, :half], values[:, half : 2 * half], atol=2e-3)
    assert (values[:, 1:] - values[:, :-1]).abs().max() < 0.25  # would break: a seam at the period


@pytest.mark.parametrize("sigma", [0.6, 1.7, 4.2, 9.0, 18.0])
def test_stack_has_the_variance_asked_for(sigma: float) -> None:
    image = torch.zeros(1, 256, 256)
    image[0, 128, 128] = 1.0
    stack = GaussianStack.build(image, 20.0)
    result = stack.at(torch.full((256, 256), 10.0), [(sigma / 10.0, 1.0)], 40.0)[0]
    x = torch.arange(256.0) - 128
    spread = float((result.sum(0) * (x - (result.sum(0) * x).sum()) ** 2).sum().sqrt())
    assert float(result.sum()) == pytest.approx(1.0, abs=1e-3)
    assert spread == pytest.approx(sigma, rel=0.08)


def _marks(count: int) -> Marks:
    s = Stream(1, "marks")
    uv = s.uniform(size=2 * count).reshape(-1, 2)
    frame = np.tile([440.0, 0.0, 290.0], (count, 1))
    return Marks(uv, frame, s.uniform(0.2, 3.0, count), s.uniform(size=count)[:, None])


def test_marks_do_not_depend_on_order_or_window() -> None:
    marks = _marks(300)
    whole = ChartWindow(0, 0, 384, 256, 384, 256)
    part = ChartWindow(100, 70, 130, 90, 384, 256)

    def drawn(listed: Marks, window: ChartWindow) -> "Tensor":
        total = accumulator(window)
        for s in stamps(listed, window):
            add(total, s.texel, s.values[0] * torch.exp(-(s.a**2 + s.b**2)))
        return finished(total, window)

    full = drawn(marks, whole)
    assert torch.equal(drawn(marks, part), part.cut(full, whole))
    assert torch.equal(drawn(marks.pick(np.arange(300)[::-1]), whole), full)
    assert full.max() > 0.1


def test_metric_of_a_point_is_finite() -> None:
    metric = Metric.of(torch.zeros(3, 8, 8))
    along, across = metric.gradient(torch.rand(8, 8))
    assert torch.isfinite(along).all()
    assert torch.isfinite(across).all()
    assert torch.isfinite(metric.texels_per_mm()).all()


def test_scatter_has_the_density_and_keeps_its_distance() -> None:
    atlas = Atlas.flat(16.0)  # 384 x 256 mm
    density = np.full(atlas.inside.shape, 4.0, np.float32)
    uv = scatter(atlas, Stream(1, "sites"), density, spacing=0.45)
    expected = 4.0 * 38.4 * 25.6
    assert abs(len(uv) - expected) < 0.06 * expected
    points = atlas.sample(atlas.position, uv)
    from scipy.spatial import cKDTree

    nearest = cKDTree(points).query(points, k=2)[0][:, 1]
    assert nearest.min() >= 0.45 * 5.0 * 0.98
    assert len(scatter(atlas, Stream(1, "none"), np.zeros_like(density))) == 0
