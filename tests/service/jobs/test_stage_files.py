"""Files of jobs: their names, and finished stages on the disk, in memory or mapped, and in which form."""

from __future__ import annotations

import io
import tempfile
import tracemalloc
import types
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pydantic import TypeAdapter

from service.jobs import stage_files as packing
from service.jobs.artifacts import Artifacts
from service.jobs.stage_files import Damaged, KeptStages, kept_types
from service.photo.photo import Photo

JOB = "a" * 32
DIGEST = "0" * 64


@pytest.fixture(params=["file", "memory"])
def artifacts(request: pytest.FixtureRequest, tmp_path: Path) -> Artifacts:
    """On a disk, and in a store that is none."""
    root = f"file://{tmp_path}/store" if request.param == "file" else f"memory://stages-{tmp_path.name}"
    made = Artifacts(root)
    made._fs.makedirs(f"{made._root}/{JOB}", exist_ok=True)
    return made


@pytest.mark.parametrize(
    "name", ["../x", f"{JOB}/../../etc/passwd", f"{JOB}/photo-{DIGEST}.zip/x", f"{JOB}/PHOTO-{DIGEST}.zip", "", "x\0y"]
)
def test_only_names_of_ours_are_names(artifacts: Artifacts, name: str) -> None:
    """No input reaches names today; if some change let it, this still keeps it inside the folder."""
    for use in (artifacts.read, artifacts.exists, artifacts.delete):
        with pytest.raises(ValueError, match="not a name"):
            use(name)


@pytest.mark.parametrize("mapped", [False, True])
def test_a_stage_is_computed_once(artifacts: Artifacts, tmp_path: Path, mapped: bool) -> None:
    told: list[str] = []
    value = np.arange(600, dtype=np.int16).reshape(20, 30)
    stages = KeptStages(artifacts, JOB, "basis", {}, tmp_path, told.append, mapped=mapped)
    first = stages.get_or_compute("one", lambda: value)
    again: Any = stages.get_or_compute("one", lambda: pytest.fail("it was computed again"))
    for found in (first, again):
        assert np.array_equal(found, value)
        assert found.dtype == value.dtype
    assert first.flags.writeable != mapped, "only what is mapped stays in its file"
    assert again.flags.writeable != mapped
    assert told == ["one"]


@pytest.mark.slow
def test_a_job_that_gets_by_with_less_memory_makes_the_same_maps_and_says_so(tmp_path: Path) -> None:
    """The pipeline with small tiles and mapped stages, against itself without. No stage may write into what it gets."""
    from service import pipeline
    from service.archive.pack import write_archive
    from service.diagnosis import SAMPLE
    from service.jobs.avatar_process import options_from
    from service.manifest import Manifest
    from service.runtime.tiles import DEFAULT_TILE, SMALL_TILE
    from service.stage_cache import NoCache, StageCache

    store, types = Artifacts(f"file://{tmp_path}/store"), kept_types(pipeline)
    stages: StageCache = KeptStages(store, JOB, "basis", types, tmp_path, mapped=True)
    options = options_from({"quality": "draft", "size": [576, 384]})
    found = []
    for kept, tile in ((stages, SMALL_TILE), (NoCache(), DEFAULT_TILE)):
        stream = io.BytesIO()
        write_archive(pipeline.make_avatar(SAMPLE.read_bytes(), options, stages=kept, tile=tile), stream)
        found.append(zipfile.ZipFile(stream))
    tight, usual = (TypeAdapter(Manifest).validate_json(archive.read("manifest.json")) for archive in found)
    assert "small-tiles" in tight.warnings
    assert "small-tiles" not in usual.warnings
    assert tight.reflectance is not None
    assert tight.reflectance.tile == SMALL_TILE
    for map_ in usual.maps:
        one, other = (cv2.imdecode(np.frombuffer(archive.read(map_.path), np.uint8), -1) for archive in found)
        assert one is not None
        assert other is not None
        apart = np.abs(one.astype(int) - other.astype(int))
        assert apart.max() <= (1 if map_.bits == 8 else 8), map_.path
        assert (apart > 0).mean() < 0.01, map_.path


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


def stage() -> Sequence[Mapping[str, Outer | None]]:
    """A function as the pipeline calls them: what may be kept follows from its annotations."""
    return []


KINDS = kept_types(types.SimpleNamespace(stage=stage, something=object()))  # type: ignore[arg-type]


def test_what_may_be_kept_follows_from_annotations() -> None:
    assert set(KINDS.values()) == {Outer, Inner}, "whatever the annotations mention, and what that holds"


@dataclass(frozen=True)
class Other:
    names: tuple[str, ...]


def test_a_file_brings_no_class_of_its_own_choice() -> None:
    """Whoever can write files of stages must not choose what is made of them."""
    written = pack(Other(()), {packing._name(Other): Other})
    with pytest.raises(Damaged, match="Other"):
        unpack(written, KINDS)
    with pytest.raises(TypeError, match="Other"):
        pack(Other(()), KINDS)


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


@settings(deadline=None)  # another program may have the processor
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


@settings(deadline=None)  # another program may have the processor
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


@pytest.mark.parametrize("value", [object(), {1, 2}, np.array([object()]), {1: "x"}, lambda: 0])
def test_what_would_need_pickle_is_refused(value: object) -> None:
    with pytest.raises(TypeError):
        pack(value, KINDS)


@settings(deadline=None)  # another program may have the processor
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


def test_a_stage_is_found_by_what_it_depends_on(tmp_path: Path) -> None:
    stages = KeptStages(Artifacts(f"file://{tmp_path / 'kept'}"), "0" * 32, "basis", {}, tmp_path)
    photo = Photo(np.zeros((2, 2, 3), np.uint8))
    assert stages.get_or_compute("hair", lambda photo, style: 1, photo, "bob") == 1
    assert stages.get_or_compute("hair", lambda photo, style: 3, Photo(photo.pixels.copy()), "bob") == 1
    assert stages.get_or_compute("hair", lambda photo, style: 4, replace(photo, focal_35mm=28.0), "bob") == 4
    assert stages.get_or_compute("hair", lambda photo, style: 5, photo, "plait") == 5


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({"a": 1}, {"a": True}), ((1, (2,)), (1, 2)), ("1", 1), (None, ()), ({"a": ""}, {"": "a"}), (b"a", "a"),
        (np.zeros(2, np.float32), np.zeros(2, np.int32)), (np.zeros((2, 3)), np.zeros((3, 2))),
        (np.arange(4.0), np.arange(4.0)[::-1]), (Photo(np.zeros((1, 1, 3), np.uint8)), None),
    ],
)  # fmt: skip
def test_what_a_stage_is_given_is_told_apart(one: object, other: object) -> None:
    digest = packing.Digests()
    assert digest(one) == digest(one) != digest(other)


def test_a_stage_is_given_nothing_that_cannot_be_looked_into(tmp_path: Path) -> None:
    stages = KeptStages(Artifacts(f"file://{tmp_path / 'kept'}"), "0" * 32, "basis", {}, tmp_path)
    with pytest.raises(TypeError, match="function"):
        stages.get_or_compute("hair", lambda network: 1, (1, lambda: 2))
