"""Folds of a smile are not black in the albedo; moles, beards and all else stay."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from service.colour import FULL_CODE, linear_to_srgb, luma, srgb_to_linear
from service.head.files import load_head
from service.reflectance.corrections.smile_folds import KEPT, fold_zone, folds, without_folds
from service.reflectance.subject import GEOMETRY_SIZE, Subject

HEAD = load_head()
SUBJECT = Subject.of(HEAD, HEAD.mean)
ZONE = fold_zone(SUBJECT.chart)
SKINS = {"dark": [0.10, 0.05, 0.035], "brown": [0.30, 0.17, 0.11], "light": [0.55, 0.36, 0.27]}
LEFT = ZONE & (np.indices(ZONE.shape)[1] > ZONE.shape[1] // 2)
"""The subject's left side of the zone."""
CENTRE = tuple(int(v.mean()) for v in np.nonzero(LEFT))


def skin_with(name: str, width: int, height: int, strength: float) -> npt.NDArray[np.float32]:
    """(h, w, 3) linear skin with an upright dark ellipse, exp(-strength) as bright, in the middle of the left zone."""
    mark: npt.NDArray[Any] = np.zeros(ZONE.shape, np.float32)
    cv2.ellipse(mark, CENTRE[::-1], (width, height), 0, 0, 360, 1.0, -1)
    mark = cv2.GaussianBlur(mark, (0, 0), 0.8)
    return np.asarray(np.array(SKINS[name], np.float32) * np.exp(-strength * mark)[..., None], np.float32)


def test_the_zone_is_beside_nose_and_mouth_on_both_sides() -> None:
    mm = SUBJECT.chart.interpolate(HEAD.mean.astype(np.float32)) * 1000
    assert 0.9 < LEFT.sum() / (ZONE.sum() - LEFT.sum()) < 1.1
    assert np.abs(mm[ZONE][:, 0]).min() > 14 and np.abs(mm[ZONE][:, 0]).max() < 50
    assert mm[ZONE][:, 2].min() > -20, "not the back of the head"


@pytest.mark.parametrize("name", SKINS)
@pytest.mark.parametrize("strength", [1.0, 2.2, 5.0])
def test_a_long_dark_line_becomes_skin_a_little_darker(name: str, strength: float) -> None:
    """A renderer shades the fold; black pigment there makes it a trench in every light."""
    found = folds(skin_with(name, 3, 20, strength), ZONE)
    middle = found[CENTRE]
    left = strength - middle
    assert KEPT < left < 0.35 + 0.5 * strength and middle > 0.4
    assert np.isfinite(found).all() and found.min() >= 0
    beside = found.copy()
    beside[CENTRE[0] - 26 : CENTRE[0] + 27, CENTRE[1] - 9 : CENTRE[1] + 10] = 0
    assert not beside.any()


@pytest.mark.parametrize(("width", "height"), [(4, 4), (18, 24)])
def test_moles_and_beards_stay(width: int, height: int) -> None:
    assert not folds(skin_with("light", width, height, 1.5), ZONE).any()


def test_lines_elsewhere_and_faint_ones_stay() -> None:
    """Brows and lashes are long dark lines too."""
    assert not folds(skin_with("light", 3, 20, 0.4), ZONE).any()
    assert not folds(skin_with("light", 3, 20, 2.0), ZONE & ~LEFT).any()


@pytest.mark.parametrize("value", [0.0, 1.0, np.nan])
def test_black_white_and_nan_change_nothing(value: float) -> None:
    """Logarithms of 0."""
    with np.errstate(all="raise", under="ignore"):
        assert not folds(np.full((*ZONE.shape, 3), value, np.float32), ZONE).any()


@pytest.mark.parametrize("size", [(768, 512), (1536, 1024)])
def test_the_map_gets_the_hue_of_skin_in_the_fold_and_nothing_elsewhere(size: tuple[int, int]) -> None:
    """Dark red brightened is orange."""
    linear = skin_with("brown", 3, 20, 2.0)
    red = linear * np.where(luma(linear) < 0.1, np.array([1.6, 0.8, 0.6], np.float32)[:, None, None], 1).transpose(
        1, 2, 0
    )
    codes = np.rint(linear_to_srgb(np.asarray(cv2.resize(red, size), np.float32)) * FULL_CODE).astype(np.uint16)
    after = without_folds(codes.copy(), SUBJECT)
    scale = size[0] // GEOMETRY_SIZE[0]
    middle = srgb_to_linear(after[CENTRE[0] * scale, CENTRE[1] * scale] / FULL_CODE)
    skin = np.array(SKINS["brown"])
    assert luma(middle) > 0.3 * luma(skin.astype(np.float32))
    assert middle[0] / middle[1] == pytest.approx(skin[0] / skin[1], rel=0.35)
    far = np.ones(after.shape[:2], bool)
    far[(CENTRE[0] - 30) * scale : (CENTRE[0] + 30) * scale, (CENTRE[1] - 12) * scale : (CENTRE[1] + 12) * scale] = (
        False
    )
    assert np.array_equal(after[far], codes[far])
