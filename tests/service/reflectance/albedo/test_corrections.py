"""The list of corrections: each has a switch that works and a count that is true."""

from __future__ import annotations

import numpy as np
import pytest

from service.colour import linear_to_srgb
from service.errors import UsageError
from service.options import Options
from service.reflectance.albedo.corrections import changed_texels
from service.reflectance.albedo.diffuse_albedo import NAMES


def test_unknown_and_doubled_names_are_refused_with_those_that_there_are() -> None:
    with pytest.raises(UsageError, match=r"'magic'.*highlights"):
        Options(without=("magic",))
    with pytest.raises(UsageError, match="twice"):
        Options(without=(NAMES[0], NAMES[0]))
    assert Options(without=NAMES).to_json()["without"] == list(NAMES)


def test_a_texel_counts_from_one_step_of_eight_bits_on() -> None:
    """In sRGB, as people see it: a step in the dark is far less light than one in the bright."""
    coded = np.linspace(0.1, 0.9, 9, dtype=np.float32)[:, None].repeat(3, 1)
    before = ((coded + 0.055) / 1.055) ** np.float32(2.4)
    for step, changed in ((0.5 / 255, 0), (1.5 / 255, 9)):
        after = ((coded + np.float32(step) + 0.055) / 1.055) ** np.float32(2.4)
        assert changed_texels(before, after) == (changed, 9)
        assert np.abs(linear_to_srgb(after) - coded - step).max() < 1e-4
