"""Frames of glasses: found where they are, never on plain skin, and replaced by the skin beside them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from service.geometry.chart import Chart
from service.head.files import load_head
from service.head.model import HeadModel
from service.texture.make import make_texture
from service.texture.segmentation.glasses import frames
from service.texture.segmentation.zones import Zones
from service.texture.unwrap import Unwrapped
from tests.service.texture.scenes import SKIN, fitted, photograph, turned
from tests.toyhead import sphere_head

Array = npt.NDArray[np.float64]
Paint = Callable[[Array], Array]

HEAD = load_head(None)
CHART = Chart.build(HEAD, 576, 384)
ZONES = Zones.of(CHART)
PLACE = CHART.inside(HEAD.mean).astype(float)
NORMAL = CHART.inside(CHART.head.mean)  # only the shape matters here
EYE = (0.0315, -0.0005)
BLACK = np.array([0.08, 0.07, 0.07])
BARE = ZONES.skin & (ZONES.features < 0.5) & (ZONES.scalp < 0.5)


def _worn(points: Array, width: float = 0.0028) -> npt.NDArray[np.bool_]:
    """(N,) bool: points (N, 3) in metres before which a frame stands: two oval rims, a bridge and two temples."""
    aside, above = np.abs(points[:, 0]), points[:, 1] - EYE[1]
    radius = np.hypot((aside - EYE[0]) / 1.2, above / 0.85)
    rim = np.abs(radius - 0.019) < width / 2
    bridge = (aside < EYE[0] - 0.022) & (np.abs(above - 0.003) < width / 2)
    temple = (aside > EYE[0] + 0.022) & (np.abs(above - 0.003) < width / 2) & (points[:, 2] < 0.03)
    return np.asarray((rim | bridge | temple) & (points[:, 2] > -0.03))


def _skin(points: Array) -> Array:
    """SkinModel in a light that falls off to one side."""
    return np.asarray(np.array(SKIN) * (0.9 + 2.5 * points[:, :1]))


def _with(base: Paint, where: Callable[[Array], npt.NDArray[np.bool_]], colour: Array = BLACK) -> Paint:
    return lambda points: np.where(where(points)[:, None], colour, base(points))


def _shown(paint: Paint, weight: float = 1.0) -> Unwrapped:
    """The mean head, of which the photo shows all that looks forward."""
    seen = (ZONES.skin & (PLACE[:, 2] > -0.05)).astype(np.float32) * np.float32(weight)
    colour = np.asarray(paint(PLACE) * (seen[:, None] > 0), np.float32)
    return Unwrapped(colour, seen, seen > 0, NORMAL, PLACE.astype(np.float32))


def _found(paint: Paint) -> npt.NDArray[np.bool_]:
    return frames(CHART, _shown(paint), ZONES)


@pytest.mark.parametrize("skin", [1.0, 0.45], ids=["light", "dark"])
def test_rims_bridge_and_temples_are_found_and_little_else(skin: float) -> None:
    found = _found(_with(lambda points: skin * _skin(points), _worn, 0.6 * skin * np.array(SKIN)))
    frame = _worn(PLACE) & BARE & (ZONES.face > 0.6)
    near = _worn(PLACE, 0.0085)
    assert found[frame].mean() > 0.97
    assert (found & ~near).sum() < 0.02 * found.sum()
    assert not (found & (ZONES.features >= 0.5)).any()


NOT_GLASSES: dict[str, Paint] = {
    "plain skin": _skin,
    "brows that meet": _with(
        _skin, lambda p: (np.abs(p[:, 0]) < 0.05) & (np.abs(p[:, 1] - EYE[1] - 0.0165) < 0.003) & (p[:, 2] > 0)
    ),
    "a shadow along the nose": _with(
        _skin, lambda p: (np.abs(p[:, 0] - 0.004) < 0.003) & (p[:, 1] < 0.02) & (p[:, 1] > -0.04) & (p[:, 2] > 0)
    ),
    "bags under the eyes": _with(
        _skin,
        lambda p: (np.abs(np.hypot(np.abs(p[:, 0]) - EYE[0], p[:, 1]) - 0.017) < 0.0015) & (p[:, 1] < -0.006),
    ),
    "rims without a bridge": _with(_skin, lambda p: _worn(p) & (np.abs(p[:, 0]) > 0.012)),
    "a dark visor": _with(_skin, lambda p: (np.abs(p[:, 1]) < 0.025) & (p[:, 2] > 0)),
    "a crease of the root of the nose": _with(
        _skin, lambda p: (np.abs(p[:, 0]) < 0.009) & (np.abs(p[:, 1] - 0.004) < 0.001), 0.8 * np.array(SKIN)
    ),
    "black": lambda p: np.zeros((len(p), 3)),
    "white": lambda p: np.ones((len(p), 3)),
}


@pytest.mark.parametrize("what", NOT_GLASSES)
def test_no_other_dark_line_is_taken_for_glasses(what: str) -> None:
    """Wrongly found they would take brows, shadows and folds off the face; logarithms of black must stay finite."""
    assert not _found(NOT_GLASSES[what]).any()


def test_nothing_seen_or_no_eyes_is_no_glasses() -> None:
    """No median of nothing, no centre of no vertices: imported heads may have no eyes."""
    paint = _with(_skin, _worn)
    assert not frames(CHART, _shown(paint, 0.0), ZONES).any()
    blind: HeadModel = replace(HEAD, part_names=tuple(f"other_{i}" for i, _ in enumerate(HEAD.part_names)))
    assert not frames(replace(CHART, head=blind), _shown(paint), ZONES).any()


def test_a_toy_head_stays_as_it_is() -> None:
    """A head without brows, lids and eyes in their place."""
    head = sphere_head(40, 60)
    texture = make_texture(
        photograph(head, turned(0), lambda p: np.broadcast_to(SKIN, (len(p), 3))),
        head,
        fitted(head, turned(0)),
        Chart.build(head, 288, 192),
    )
    assert "glasses-removed" not in texture.warnings


def test_the_skin_under_a_frame_is_made_up_from_beside_it() -> None:
    """Left in, a frame is as dark as it is; filled wrongly, from its own blurred rim, still a third of that."""
    textures = [
        make_texture(photograph(HEAD, turned(0, 700), paint), HEAD, fitted(HEAD, turned(0, 700)), CHART)
        for paint in (_skin, _with(_skin, _worn))
    ]
    bare, worn = textures
    assert worn.warnings == ("glasses-removed",) and bare.warnings == ()
    inside = np.zeros(CHART.mask.shape, bool)
    inside.ravel()[CHART.texels] = _worn(PLACE) & BARE & (ZONES.face > 0.6)
    off = np.abs(worn.texture.astype(int) - bare.texture)[inside].max(1)
    assert np.median(off) < 8 and np.quantile(off, 0.98) < 30
    assert (worn.lit_skin[inside] < 128).mean() > 0.97 and (worn.confidence[inside] == 0).mean() > 0.9
    elsewhere = CHART.mask & ~inside & (bare.confidence > 250) & (worn.confidence > 250)
    assert np.quantile(np.abs(worn.texture.astype(int) - bare.texture)[elsewhere].max(1), 0.99) < 10
