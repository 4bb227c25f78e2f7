from __future__ import annotations

import numpy as np
import pytest

from service.colour import LUMA, from_codes, to_codes
from service.errors import ModelFault
from service.reflectance.planes import Planes, interpolated
from service.runtime.tiles import reflected


@pytest.mark.parametrize("size", [(48, 32), (36, 24), (12, 8), (9, 6), (50, 31)])
def test_a_linear_field_stays_linear_between_the_centres(size: tuple[int, int]) -> None:
    """Centres aligned: half a texel of shift would show at every ratio. Beyond the outer centres the edge goes on."""
    field = np.linspace(0, 1, 12, dtype=np.float32)[None] + 2 * np.linspace(0, 1, 8, dtype=np.float32)[:, None]
    rows, columns = np.arange(size[1]), np.arange(size[0])
    x = np.clip((columns + 0.5) * 12 / size[0] - 0.5, 0, 11) / 11
    y = np.clip((rows + 0.5) * 8 / size[1] - 0.5, 0, 7) / 7
    np.testing.assert_allclose(interpolated(field, size, rows, columns), x[None] + 2 * y[:, None], atol=1e-5)


@pytest.mark.parametrize("size", [(192, 128), (100, 70)])
def test_a_part_is_that_part_of_the_whole(size: tuple[int, int]) -> None:
    """Also where a tile's halo turns at the border of the map."""
    field = np.random.default_rng(0).normal(0, 1, (16, 24)).astype(np.float32)
    whole = interpolated(field, size, np.arange(size[1]), np.arange(size[0]))
    for top, left in ((-20, -9), (0, 0), (37, 41), (size[1] - 10, size[0] - 25)):
        rows, columns = reflected(size[1], top, top + 30), reflected(size[0], left, left + 50)
        np.testing.assert_allclose(interpolated(field, size, rows, columns), whole[np.ix_(rows, columns)], atol=1e-5)


def test_codes_hold_colours_to_a_65536th() -> None:
    values = np.linspace(-1, 1, 1001, dtype=np.float32)
    np.testing.assert_allclose(from_codes(to_codes(values)), values, atol=1.6e-5)
    assert to_codes(np.array([-7.0, 7.0], np.float32)).tolist() == [0, 65535]


def test_channels_by_name() -> None:
    codes = np.random.default_rng(1).integers(0, 65536, (6, 9, 3), np.uint16)
    planes = Planes((9, 6))
    planes.add_codes("albedo", codes)
    rows, columns = np.array([5, 4, 4, 0]), np.array([0, 1, 8])
    red, grey = planes.read(["albedo_r", "albedo_grey"])(rows, columns)
    np.testing.assert_allclose(red, from_codes(codes[..., 0])[np.ix_(rows, columns)])
    np.testing.assert_allclose(grey, (from_codes(codes) @ LUMA)[np.ix_(rows, columns)], atol=1e-6)
    np.testing.assert_allclose(
        planes.shrunk(["albedo_r"], (3, 2))[0, 0, 0], from_codes(codes[:3, :3, 0]).mean(), atol=3e-5
    )
    planes.drop("albedo")
    with pytest.raises(ModelFault, match="no channel 'albedo_r'"):
        planes.read(["albedo_r"])
