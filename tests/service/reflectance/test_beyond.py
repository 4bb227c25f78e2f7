"""Albedo beyond the islands of the chart."""

from __future__ import annotations

import numpy as np

from service.geometry.chart import NO_PART
from service.head.files import load_head
from service.reflectance.beyond import skin_goes_on
from service.reflectance.subject import Subject

HEAD = load_head()
SIZE = (1536, 1024)


def test_skin_goes_on_beyond_its_island_and_nothing_on_it_changes() -> None:
    """Another tone out there was a crease along the rim of the neck in the normals."""
    subject = Subject.of(HEAD, HEAD.mean)
    part = subject.islands(SIZE)
    albedo = np.full((SIZE[1], SIZE[0], 3), 30000, np.uint16)
    albedo[part == NO_PART] = 50000
    albedo[(part != NO_PART) & (part != HEAD.part_names.index("skin"))] = 10000
    after = skin_goes_on(albedo.copy(), subject)
    assert np.array_equal(after[part != NO_PART], albedo[part != NO_PART])
    outside = after[part == NO_PART]
    assert (outside == 30000).all(1).mean() > 0.8  # the others lie beside eyes and teeth
    assert set(np.unique(outside)) <= {30000, 50000}
