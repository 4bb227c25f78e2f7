"""Roughness, cavity and thickness."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.reflectance.relief.displacement import encode_heights
from service.reflectance.surface_maps import (
    FLOOR,
    LARGEST_MM,
    cavity,
    flesh_mm,
)
from tests.toyhead import CENTRE, sphere_head


def test_thickness_of_a_ball_is_its_diameter_and_of_a_plate_its_own() -> None:
    head = sphere_head(24, 48)
    skin = np.unique(head.triangles[head.triangle_part == 0])
    small = (head.mean - CENTRE) * 0.1 + CENTRE  # 18 mm across
    found = flesh_mm(head, small)
    assert np.abs(found[skin] - 18.0).max() < 0.6
    plate = (head.mean - CENTRE) * [1.0, 1.0, 0.02] + CENTRE  # 3.6 mm thick in the middle
    middle = skin[np.linalg.norm((head.mean[skin] - CENTRE)[:, :2], axis=1) < 0.02]
    flat = flesh_mm(head, plate)[middle]
    assert 3.0 < np.median(flat) < 4.5
    assert (flesh_mm(head, head.mean)[skin] == LARGEST_MM).all(), "a whole head is thick"
    others = np.setdiff1d(np.arange(len(head.mean)), skin)
    assert (found[others] == LARGEST_MM).all()


def test_cavity_is_open_where_flat_or_raised_and_dark_in_pits() -> None:
    height = np.zeros((60, 90), np.float32)
    assert np.allclose(cavity(encode_heights(height), 0.25, (90, 60)), 1.0, atol=1e-3)
    height[30, 45] = -0.2
    height[10, 20] = 0.2
    found = cavity(encode_heights(height), 0.25, (90, 60))
    assert found[30, 45] < 0.6 and found[10, 20] == pytest.approx(1.0, abs=1e-3)
    height[30, 45] = -1.0
    assert cavity(encode_heights(height), 0.25, (90, 60))[30, 45] == pytest.approx(FLOOR, abs=0.02)
    assert np.isfinite(cavity(encode_heights(height), 0.0, (90, 60))).all(), "a chart without a size"


def test_a_head_without_skin_is_thick() -> None:
    head = sphere_head(8, 12)
    bare = replace(head, triangle_part=np.ones_like(head.triangle_part))
    assert (flesh_mm(bare, head.mean) == LARGEST_MM).all()
