"""Compositing from near to far, and every fragment behind a pixel."""

from __future__ import annotations

import numpy as np

from service.geometry.layers import composite, transmittances
from service.geometry.raster import fragments, rasterise


def test_layers_are_composited_as_one_by_one() -> None:
    rng = np.random.default_rng(1)
    pixel = np.sort(rng.integers(0, 20, 200))
    colour, alpha = rng.uniform(0, 1, (200, 3)), rng.uniform(0, 1, 200)
    wanted = np.zeros((20, 4))
    for p, c, a in zip(pixel[::-1], colour[::-1], alpha[::-1], strict=True):  # the furthest first
        wanted[p] = a * np.array([*c, 1.0]) + (1 - a) * wanted[p]
    np.testing.assert_allclose(composite(pixel, colour, alpha, 20), wanted, atol=1e-5)


def test_nothing_shows_behind_an_opaque_layer_and_no_layer_is_no_colour() -> None:
    assert transmittances(np.array([3, 3, 3]), np.array([0.0, 1.0, 0.5]))[2] < 1e-6
    none = np.zeros(0, np.int64)
    assert not composite(none, np.zeros((0, 3)), np.zeros(0), 5).any()


def test_fragments_are_all_surfaces_in_order() -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(-5, 25, (30, 2))
    depth, triangles = rng.uniform(0.5, 2.0, 30), rng.integers(0, 30, (40, 3))
    found = fragments(points, depth, triangles, 20, 16)
    assert (np.diff(found.pixel) >= 0).all()
    same = np.diff(found.pixel) == 0
    assert (np.diff(found.depth)[same] >= 0).all()
    nearest = rasterise(points, depth, triangles, 20, 16, perspective=True)
    pixel, first = np.unique(found.pixel, return_index=True)
    assert np.array_equal(pixel, np.flatnonzero(nearest.mask))
    np.testing.assert_allclose(found.depth[first], nearest.depth.ravel()[pixel], rtol=1e-5)
    shallow = fragments(points, depth, triangles, 20, 16, nearer=np.full((16, 20), 1.0, np.float32))
    assert len(shallow.pixel) == (found.depth < 1.0).sum() > 0
    assert not len(fragments(points + 1000, depth, triangles, 20, 16).pixel)
