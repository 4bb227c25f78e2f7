"""The tongue passes over the lower teeth at every activation of tongueOut, and a head is changed once."""

from __future__ import annotations

import numpy as np
import pytest

from models.head.crossing import crossing_pairs
from models.head.piercing import groups, with_insets
from models.head.tongue import UP_M
from service.head.files import load_head
from service.head.model import HeadModel


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return load_head()


@pytest.mark.parametrize("out", [0.0, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0])
def test_the_tongue_crosses_nothing_on_its_way_out(head: HeadModel, out: float) -> None:
    """At one half it went through the gums of the lower teeth, 350 triangles of them, and through the lip."""
    surfaces = groups(head)
    activation = np.zeros(len(head.expression_names))
    activation[head.expression_names.index("tongueOut")] = out
    points = with_insets(head.shape(np.zeros(0), activation).astype(np.float64))
    for name in ("teeth_lower_gums", "teeth_upper_gums", "skin"):
        assert not len(crossing_pairs(points, surfaces[name], surfaces["tongue_body"])), name


def test_a_resting_tongue_stays_behind_the_upper_teeth(head: HeadModel) -> None:
    points, surfaces = with_insets(head.mean.astype(np.float64)), groups(head)
    tongue, upper = (points[np.unique(surfaces[name])] for name in ("tongue_body", "teeth_upper_gums"))
    assert tongue[:, 2].max() < upper[:, 2].max() - 0.003
    tip = tongue[tongue[:, 2] > tongue[:, 2].max() - 0.003]
    lower = points[np.unique(surfaces["teeth_lower_gums"])]
    assert tip[:, 1].mean() > lower[np.abs(lower[:, 0]) < 0.006, 1].mean() - 0.5 * UP_M
