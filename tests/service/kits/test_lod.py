"""Levels of detail of hair; those of the head are tested with the kits."""

from __future__ import annotations

import numpy as np
import pytest

from service.hair.cards import Budget, hair_parts
from service.hair.groom import make_groom
from service.hair.scalp import mean_scalp
from service.hair.style import NAMED
from service.kits.lod import reduced


def test_of_hair_whole_ribbons_are_left_and_get_wider() -> None:
    hair, edge, cap = hair_parts(make_groom(NAMED["bob"], 3, 1500), mean_scalp(), Budget(9_000, 256))
    for part in (hair, edge, cap):
        for share, less in zip((1.0, 0.5, 0.1), reduced(part, (1.0, 0.5, 0.1)), strict=True):
            assert len(less.faces) <= len(part.faces)
            if part is hair:
                assert len(less.faces) == pytest.approx(share * len(hair.faces), rel=0.05)
            assert less.normals is not None
            assert np.isfinite(less.vertices).all()
    wide = np.linalg.norm(hair.vertices[1::2] - hair.vertices[::2], axis=1)
    half = reduced(hair, (0.5,))[0]
    assert np.linalg.norm(half.vertices[1::2] - half.vertices[::2], axis=1).mean() > 1.3 * wide.mean()
