from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from service import diagnosis
from service.errors import ModelFault


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "a file.bin").write_bytes(b"weights")
    digest = hashlib.sha256(b"weights").hexdigest()
    (tmp_path / diagnosis.SUMS).write_text(f"{digest}  sub/a file.bin\n", "utf-8")
    return tmp_path


def test_one_flipped_bit_is_found(folder: Path) -> None:
    (folder / "sub" / "a file.bin").write_bytes(b"weighus")
    (fault,) = diagnosis.data_faults(folder)
    assert "a file.bin" in fault
    assert hashlib.sha256(b"weights").hexdigest() in fault


def test_a_missing_list_is_a_fault_of_its_own(tmp_path: Path) -> None:
    with pytest.raises(ModelFault, match=diagnosis.SUMS):
        diagnosis.data_faults(tmp_path)


@pytest.mark.parametrize("line", ["", "abc  file", "0" * 64 + "  ", "0" * 64 + " file"])
def test_a_damaged_list_is_not_read_as_an_empty_one(tmp_path: Path, line: str) -> None:
    (tmp_path / diagnosis.SUMS).write_text(f"{line}\n", "utf-8")
    with pytest.raises(ModelFault, match="line"):
        diagnosis.data_faults(tmp_path)


def test_a_missing_file_is_found(folder: Path) -> None:
    (folder / "sub" / "a file.bin").unlink()
    (fault,) = diagnosis.data_faults(folder)
    assert "a file.bin" in fault
