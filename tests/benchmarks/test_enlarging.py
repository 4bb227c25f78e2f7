"""The bound on enlarging finds what there is to know, and nothing where there is nothing."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")

from torch.nn import functional  # noqa: E402

from benchmarks.enlarging import estimated, learnt, scores  # noqa: E402
from models.networks.rcan import SCALE  # noqa: E402
from models.training.tasks import Batch  # noqa: E402

pytestmark = pytest.mark.train

SIDE = 24


def pairs(count: int, seed: int, sigma: float) -> list[Batch]:
    """Large textures of noise as smooth as ``sigma`` small texels, and their means over 8 x 8."""
    generator = torch.Generator().manual_seed(seed)
    found = []
    for _ in range(count):
        rough = torch.randn(1, 3, SIDE * SCALE, SIDE * SCALE, generator=generator)
        for _ in range(3):  # boxes, one after the other, are near to a Gaussian
            width = max(int(2 * sigma * SCALE) | 1, 1)
            rough = functional.avg_pool2d(rough, width, 1, width // 2, count_include_pad=False)
        large = 0.5 + 0.1 * rough / rough.std()
        small = functional.avg_pool2d(large, SCALE)
        found.append({"large": large[0], "small": small[0], "mask": torch.ones(1, SIDE, SIDE)})
    return found


def test_smooth_textures_are_told_better_than_by_bicubic_and_noise_is_not() -> None:
    """Bicubic knows nothing of the means that small texels are; of white noise nobody knows more than its mean."""
    smooth = scores(pairs(3, 2, 0.8), learnt(pairs(8, 1, 0.8)))
    assert smooth[1] > smooth[0] + 1.0
    noise = scores(pairs(3, 4, 0.0), learnt(pairs(8, 3, 0.0)))
    assert noise[1] == pytest.approx(noise[0], abs=0.2)


def test_one_colour_stays_and_weights_are_finite() -> None:
    """Inputs without any variance: the normal equations are singular."""
    flat = {"large": torch.full((3, SIDE * SCALE, SIDE * SCALE), 0.4), "small": torch.full((3, SIDE, SIDE), 0.4),
            "mask": torch.ones(1, SIDE, SIDE)}  # fmt: skip
    weights = learnt([flat])
    assert torch.isfinite(weights).all()
    assert torch.allclose(estimated(flat["small"][None], weights), flat["large"][None], atol=1e-4)
