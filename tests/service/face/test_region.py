from __future__ import annotations

import numpy as np
import pytest

from service.face.region import Region, roll


@pytest.mark.parametrize(
    "region", [Region(30.0, 40.0, 25.0), Region(-3.5, 812.0, 300.0, 2.1), Region(9.0, 9.0, 1.0, -3.0)]
)
def test_points_come_back(region: Region) -> None:
    points = np.random.default_rng(1).uniform(-50, 300, (20, 3))
    assert np.allclose(region.to_crop(region.to_photo(points, 192), 192), points, atol=1e-9)


@pytest.mark.parametrize("side", [40.0, 96.0, 250.0, 700.0])
@pytest.mark.parametrize("angle", [0.0, 0.6, np.pi / 2, np.pi])
def test_what_is_cut_out_lies_where_the_maths_says(side: float, angle: float) -> None:
    """A half-pixel slip in the crop would shift every landmark: a blob must appear at the computed place."""
    photo = np.zeros((800, 900, 3), np.uint8)
    spot = np.array([460.5, 390.5])
    yy, xx = np.mgrid[:800, :900] + 0.5
    photo[:] = (255 * np.exp(-((xx - spot[0]) ** 2 + (yy - spot[1]) ** 2) / (2 * (side / 20) ** 2)))[..., None]
    region = Region(spot[0] + side * 0.1, spot[1] - side * 0.15, side, angle)
    crop = region.cut(photo, 96)[..., 0].astype(float)
    cy, cx = np.mgrid[:96, :96] + 0.5
    found = np.array([(crop * cx).sum(), (crop * cy).sum()]) / crop.sum()
    assert np.allclose(found, region.to_crop(spot[None], 96)[0], atol=0.15)


def test_outside_the_photo_is_black() -> None:
    photo = np.full((50, 60, 3), 200, np.uint8)
    assert not Region(-500.0, -500.0, 40.0).cut(photo, 32).any()
    crop = Region(0.0, 25.0, 40.0).cut(photo, 32)
    assert not crop[:, :15].any()
    assert (crop[:, 17:] == 200).all()


def test_roll_of_coinciding_points_is_zero() -> None:
    point = np.array([3.0, 4.0])
    assert roll(point, point, point) == 0.0
