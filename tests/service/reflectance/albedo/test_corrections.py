"""The list of corrections: each has a switch that works and a count that is true."""

from __future__ import annotations

import pytest

from service.errors import UsageError
from service.options import Options
from service.reflectance.albedo.diffuse_albedo import NAMES


def test_unknown_and_doubled_names_are_refused_with_those_that_there_are() -> None:
    with pytest.raises(UsageError, match=r"'magic'.*highlights"):
        Options(without=("magic",))
    with pytest.raises(UsageError, match="twice"):
        Options(without=(NAMES[0], NAMES[0]))
    assert Options(without=NAMES).to_json()["without"] == list(NAMES)
