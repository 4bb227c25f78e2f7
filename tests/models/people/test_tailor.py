"""The file of what is worn."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

from models.people.tailor import write_items
from service.anatomy.items import read_items


def test_a_file_comes_back_as_it_was_written(tmp_path: Path) -> None:
    shipped = read_items()
    items = [shipped.items["brow/eyebrow001"], shipped.items["bust/body"]]
    for path in (tmp_path / "a.npz", tmp_path / "b.npz"):
        write_items(items, shipped.fitted_head, path)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    again = read_items(tmp_path / "a.npz").items["brow/eyebrow001"]
    np.testing.assert_allclose(again.rest, items[0].rest, atol=1e-5)
    assert np.array_equal(again.picture, items[0].picture) and np.array_equal(again.triangles, items[0].triangles)
