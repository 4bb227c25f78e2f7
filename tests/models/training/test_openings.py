"""What the networks of lids and lips are taught on."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")

from models.training.openings import FILLED, WHITENED, whitened  # noqa: E402

pytestmark = pytest.mark.train


def test_teeth_are_painted_inside_of_mouths_alone_and_some_fill_them() -> None:
    """Paint on a lip would move the edge that is the truth; a mouth without any inside stays as it is."""
    image = torch.full((400, 3, 64, 64), 120, dtype=torch.uint8)
    mouth = torch.zeros((400, 1, 64, 64), dtype=torch.uint8)
    mouth[:300, :, 28:36, 12:52] = 255
    image[:300, :, 28:36, 12:52] = 10
    shown = whitened(image, mouth, torch.Generator().manual_seed(1))
    outside = (mouth == 0).expand_as(image)
    assert shown.dtype == torch.uint8 and torch.equal(shown[outside], image[outside])
    assert torch.equal(shown[300:], image[300:])
    filled = (shown[:300, :, 28:36, 12:52].float().mean((1, 2, 3)) > 60).float().mean()
    assert abs(float(filled) - WHITENED * FILLED) < 0.1, "too dark for teeth, but what is filled"


def test_black_patches_stay_finite() -> None:
    """Nothing is as bright as skin there: white is black."""
    dark = torch.zeros((8, 3, 64, 64), dtype=torch.uint8)
    shown = whitened(dark, torch.full((8, 1, 64, 64), 255, dtype=torch.uint8), torch.Generator().manual_seed(2))
    assert not shown.any()
