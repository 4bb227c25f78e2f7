"""Numbers in USD files are short, right, and readable by parsers of JSON, as that of three.js is."""

from __future__ import annotations

import json
import re

import numpy as np

from service.archive.pack import archive_members
from service.archive.usd_text import fixed_tuples
from tests.service.archive.toys import toy_avatar


def test_tuples_say_the_rounded_values() -> None:
    values = np.random.default_rng(2).normal(0, 10.0 ** np.arange(-7, 3), (50, 10))
    values[0] = [0, 1, -1, 0.5, -0.5, 0.01, -0.01, 100, -100, 0.000049]
    read = json.loads("[" + fixed_tuples(values, 4).replace("(", "[").replace(")", "]") + "]")
    np.testing.assert_allclose(read, np.round(values, 4), atol=1e-9)


def test_every_array_of_numbers_is_one_of_json() -> None:
    text = archive_members(toy_avatar())["mesh/head.usda"].decode()
    arrays = re.findall(r"(?:float|int|double|point|vector|normal|texCoord|matrix|quat)\w*\[\] [\w:]+ = (\[.*\])", text)
    assert len(arrays) > 20
    for array in arrays:
        json.loads(array.replace("(", "[").replace(")", "]"))
