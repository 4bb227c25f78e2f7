"""What shows of a neck between jaw and collar."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.geometry.chart import Chart
from service.head.files import load_head
from service.texture.segmentation.small_components import small_components
from service.texture.segmentation.zones import Zones

CHART = Chart.build(load_head(None), 288, 192)
ZONES = Zones.of(CHART)
X, Y = CHART.texels % CHART.width, CHART.texels // CHART.width
NECK = ZONES.skin & (ZONES.neck > 0.9) & (ZONES.face < 0.1)
FACE = ZONES.skin & (ZONES.face > 0.9)


def _patch(where: np.ndarray, share: float) -> np.ndarray:
    """(N,) bool: the lowest texels of a zone, as many as a share of the neck's."""
    chosen = np.flatnonzero(where)
    lowest = chosen[np.argsort(-Y[chosen], kind="stable")]
    found = np.zeros(len(where), bool)
    found[lowest[: round(share * float((ZONES.neck * ZONES.skin).sum()))]] = True
    return found


def test_a_small_patch_of_neck_is_left_out_and_a_large_one_kept() -> None:
    small, large = (_patch(NECK, share).astype(np.float32) for share in (0.04, 0.4))
    assert small.any() and np.array_equal(small_components(CHART, small, ZONES), small > 0)
    assert not small_components(CHART, large, ZONES).any()


def test_the_face_is_kept_whatever_stands_beside_it() -> None:
    """A patch of the face as small as a scrap, and a neck that hangs together with the whole face."""
    cheek = _patch(FACE, 0.02).astype(np.float32)
    assert cheek.any() and not small_components(CHART, cheek, ZONES).any()
    both = np.where(ZONES.skin, np.float32(0.7), np.float32(0.0))
    assert not small_components(CHART, both, ZONES).any()


@pytest.mark.parametrize("nothing", ["seen", "neck"])
def test_nothing_seen_and_no_neck(nothing: str) -> None:
    """Shares of no texels must not divide by zero; imported heads may lack the region."""
    seen = np.zeros(len(X), np.float32) if nothing == "seen" else _patch(NECK, 0.04).astype(np.float32)
    zones = ZONES if nothing == "seen" else replace(ZONES, neck=np.zeros_like(ZONES.neck))
    assert not small_components(CHART, seen, zones).any()
