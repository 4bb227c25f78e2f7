from __future__ import annotations

import io
import os
import sys
import tempfile
import tracemalloc
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from service.jobs import packing
from service.jobs.packing import Damaged
from service.jobs.process import resident_mb


@dataclass(frozen=True)
class Inner:
    pixels: np.ndarray
    names: tuple[str, ...]


@dataclass(frozen=True)
class Outer:
    inner: Inner
    score: float | None
    light: np.ndarray | None
    facts: dict[str, float]


KINDS: dict[str, type] = {"Inner": Inner, "Outer": Outer}


def pack(value: object, kinds: Mapping[str, type]) -> bytes:
    stream = io.BytesIO()
    packing.pack(value, kinds, stream)
    return stream.getvalue()


def unpack(data: bytes, kinds: Mapping[str, type]) -> Any:
    return packing.unpack(io.BytesIO(data), kinds)


def test_a_result_comes_back_to_the_last_bit() -> None:
    value = Outer(Inner(np.arange(24, dtype=np.uint8).reshape(2, 4, 3), ("a", "ä")), 0.1 + 0.2, None, {"x": 1e-320})
    back = unpack(pack(value, KINDS), KINDS)
    assert back.inner.pixels.dtype == np.uint8
    assert np.array_equal(back.inner.pixels, value.inner.pixels)
    assert (back.inner.names, back.score, back.light, back.facts) == (value.inner.names, value.score, None, value.facts)


@given(
    hnp.arrays(st.sampled_from([np.float32, np.float64, np.int16, np.bool_]), hnp.array_shapes(max_dims=3, max_side=5))
)
def test_arrays_keep_kind_shape_bytes_and_order(array: np.ndarray) -> None:
    """Fortran order too: another order in memory gives sums another rounding."""
    for laid in (array, np.asfortranarray(array)):
        back = unpack(pack(laid, {}), {})
        assert back.dtype == laid.dtype
        assert back.shape == laid.shape
        assert back.tobytes() == laid.tobytes()
        assert back.flags.f_contiguous == laid.flags.f_contiguous


@pytest.mark.parametrize("value", [np.float32(1.5), np.int64(-3), (1, (2.5, "x"), [None, True]), {"a": {"b": ()}}])
def test_numbers_and_containers_keep_their_kind(value: object) -> None:
    back = unpack(pack(value, {}), {})
    assert back == value
    assert type(back) is type(value)


@given(st.data())
def test_every_change_and_every_cut_is_noticed(data: st.DataObject) -> None:
    """A torn file after a power cut must be computed again, not believed."""
    packed = pack((np.arange(50), "words"), {})
    at = data.draw(st.integers(0, len(packed) - 1))
    flipped = bytearray(packed)
    flipped[at] ^= data.draw(st.integers(1, 255))
    for broken in (bytes(flipped), packed[:at], packed + b"x"):
        with pytest.raises(Damaged):
            unpack(broken, {})


def test_a_class_that_is_gone_is_damage() -> None:
    """After an upgrade the stages of an older version may name what there is no more."""
    with pytest.raises(Damaged, match="another version"):
        unpack(pack(Inner(np.zeros(1), ()), KINDS), {})


@pytest.mark.parametrize("value", [object(), {1, 2}, np.array([object()]), {1: "x"}, lambda: 0])
def test_what_would_need_pickle_is_refused(value: object) -> None:
    with pytest.raises(TypeError):
        pack(value, KINDS)


@given(
    st.lists(
        hnp.arrays(
            st.sampled_from([np.float32, np.uint8, np.int16, np.bool_]), hnp.array_shapes(max_dims=3, max_side=7)
        ),
        max_size=4,
    ),
    st.text(max_size=70),
)
def test_what_is_mapped_is_the_same_and_begins_where_the_processor_likes_it(arrays: Any, words: str) -> None:
    """Arrays that begin anywhere are summed in another order, which changes last bits."""
    with tempfile.TemporaryFile() as stream:
        packing.pack((*arrays, np.asfortranarray(np.ones((2, 3))), np.float32(2), words), {}, stream)
        stream.seek(0)
        *back, fortran, number, text = packing.unpack(stream, {}, mapped=True)
    for array, again in zip(arrays, back, strict=True):
        assert (again.dtype, again.shape, again.tobytes()) == (array.dtype, array.shape, array.tobytes())
        assert again.ctypes.data % 64 == 0
        assert not again.flags.writeable
    assert fortran.flags.f_contiguous
    assert (number, text) == (np.float32(2), words)


@pytest.mark.skipif(sys.platform != "linux", reason="/proc tells what memory is a process's own")
def test_what_is_mapped_is_no_memory_of_the_process(tmp_path: Path) -> None:
    """The limit of a job counts memory of its own; maps of earlier stages must not be among it."""
    path = tmp_path / "kept"
    with path.open("wb") as target:
        packing.pack(np.ones(64 << 20, np.uint8), {}, target)
    before = resident_mb(os.getpid())
    with path.open("rb") as source:
        mapped = packing.unpack(source, {}, mapped=True)
    assert int(mapped.sum(dtype=np.int64)) == 64 << 20, "every page was looked at"
    assert resident_mb(os.getpid()) - before < 16


def test_a_large_map_is_not_copied_as_a_whole(tmp_path: Path) -> None:
    """Keeping a map of 150 MB must not need another 150 MB beside it."""
    value = np.arange(48 << 20, dtype=np.uint8)
    path = tmp_path / "kept"
    tracemalloc.start()
    try:
        with path.open("wb") as target:
            packing.pack(value, {}, target)
        written = tracemalloc.get_traced_memory()[1]
        tracemalloc.reset_peak()
        with path.open("rb") as source:
            back = packing.unpack(source, {})
        read = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert np.array_equal(back, value)
    assert written < 0.8 * value.nbytes
    assert read < 1.5 * value.nbytes
