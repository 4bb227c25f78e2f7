"""Several photos as one file."""

from __future__ import annotations

import pytest

from service.photo.bundle import MOST, bundled, index_of, unbundled


@pytest.mark.parametrize("count", [1, 2, 3, MOST])
def test_files_come_out_as_they_went_in(count: int) -> None:
    files = [bytes([k]) * (k * 7) for k in range(count)]
    assert unbundled(bundled(files)) == files


def test_one_file_is_itself_and_several_begin_with_the_first() -> None:
    """What only reads images shows the first photo of several."""
    assert bundled([b"photo"]) == b"photo"
    assert bundled([b"photo", b"other"]).startswith(b"photoother")


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"photo",
        b"photo" + index_of([3, 3]),  # lengths that are not those of the files
        b"photo" + index_of([5, 1 << 40]),
        b"x" * (MOST + 1) + index_of([1] * (MOST + 1)),
        index_of([1, 1])[-12:],  # cut off
    ],
)
def test_an_index_that_cannot_be_right_is_part_of_a_photo(data: bytes) -> None:
    assert unbundled(data) == [data]
