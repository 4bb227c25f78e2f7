"""Data for training, drawn in shards: real captures of the light stage into a store and into a folder, by seed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from models.drawing import draw_all
from service.errors import UsageError
from service.jobs.database import FileLock
from tests.service.jobs.s3 import serve


def test_a_second_drawing_into_a_folder_is_refused_before_it_touches_the_first_ones_orders(tmp_path: Path) -> None:
    """They lie in one folder: the second call deleted them, and all files of the first failed as unreadable."""
    order = tmp_path / ".batch" / "orders" / "train" / "1_neutral.json"
    order.parent.mkdir(parents=True)
    order.write_text("{}")
    lock = FileLock(tmp_path / ".batch", "drawing")
    with pytest.raises(UsageError, match="in use by another drawing"):
        draw_all({"train/2_neutral.npz": {"what": "captures"}}, str(tmp_path))
    assert order.exists()
    lock.release()


@pytest.fixture
def bucket() -> Iterator[Any]:
    import fsspec

    for _ in serve():
        yield fsspec.filesystem("s3", use_listings_cache=False)


@pytest.mark.train
@pytest.mark.slow
def test_captures_go_whole_into_a_store_or_a_folder(
    bucket: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The same seeds give the same arrays wherever they go; what is there is not drawn again, and no order is left."""
    pytest.importorskip("torch")
    from models.training.factory import main as draw_captures
    from models.training.store import Wholes

    draw_captures("s3://bucket/captures", count=2, whole_only=True, lights=1)
    names = [path.removeprefix("bucket/captures/") for path in bucket.find("bucket/captures")]
    data = sorted(name for name in names if name.endswith(".npz"))
    assert len(data) == 2 and all(name.startswith("train/") for name in data)
    assert not [name for name in names if "orders" in name]
    fetched = tmp_path / "fetched" / "train"
    bucket.get("bucket/captures/train/", str(fetched), recursive=True)
    (tmp_path / "drawn" / "train").mkdir(parents=True)
    (tmp_path / "drawn" / data[1]).write_bytes(b"was there")
    draw_captures(str(tmp_path / "drawn"), count=2, whole_only=True, lights=1)
    assert "2 files, 1 of them there already" in capfd.readouterr().err
    assert (tmp_path / "drawn" / data[1]).read_bytes() == b"was there"
    with np.load(tmp_path / "drawn" / data[0]) as here, np.load(tmp_path / "fetched" / data[0]) as there:
        assert set(here.files) == set(there.files)
        assert all(np.array_equal(here[name], there[name], equal_nan=True) for name in here.files)
    charts = Wholes(fetched)
    charts.refresh()
    assert len(charts.items) == 2
