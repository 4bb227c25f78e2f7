"""Compiled networks that are kept: found again, and never trusted when they were cut off or are of something else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from service.runtime import compiled_networks
from service.runtime.networks import choose_engine, load_network
from service.runtime.sessions import has_openvino


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(compiled_networks.VARIABLE, str(tmp_path))
    return tmp_path / "networks"


def test_what_was_kept_is_read_until_it_is_changed(cache: Path) -> None:
    place = compiled_networks.place("psi", b"model", "2026.1", {"threads": 2})
    assert place is not None and place.parent == cache
    assert compiled_networks.read(place) is None
    compiled_networks.write(place, b"compiled")
    assert compiled_networks.read(place) == b"compiled"
    assert compiled_networks.kept() == (1, (32 + 8) / 1e6)
    others = [("psi", b"model", "2026.2", {"threads": 2}), ("psi", b"model", "2026.1", {"threads": 1}),
              ("psi", b"other", "2026.1", {"threads": 2})]  # fmt: skip
    assert all(compiled_networks.read(compiled_networks.place(*other)) is None for other in others)
    place.write_bytes(place.read_bytes()[:-1])
    assert compiled_networks.read(place) is None
    assert not place.exists()


def test_only_the_latest_are_kept_and_none_where_none_are_wanted(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(compiled_networks.MOST + 3):
        compiled_networks.write(compiled_networks.place(f"n{number}", b"", "1", {}), b"x")
    assert compiled_networks.kept()[0] == compiled_networks.MOST
    monkeypatch.setenv(compiled_networks.VARIABLE, "none")
    assert compiled_networks.folder() is None
    assert compiled_networks.place("psi", b"", "1", {}) is None


@pytest.mark.skipif(not has_openvino(), reason="OpenVINO is not installed")
def test_a_network_that_was_kept_gives_the_same_values(cache: Path) -> None:
    engine = choose_engine("openvino")
    results = []
    for _ in range(2):
        description, compute = load_network("psi", engine)
        side = 2 * description.stride + 2 * description.margin
        maps = np.random.default_rng(0).uniform(-1, 1, (1, len(description.channels), side, side)).astype(np.float32)
        results.append(compute(maps))
        assert len(list(cache.glob("psi-*.blob"))) == 1
    np.testing.assert_array_equal(results[0], results[1])
