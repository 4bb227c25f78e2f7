"""Writes head model files (``docs/head-model.md``), which ``service.head.files`` reads."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from service.head.files import FORMAT, STORED, TEXT, check
from service.head.model import HeadModel

HALF = ("identity", "expression", "regions")
"""Arrays that are stored as float16."""


def save_head(model: HeadModel, path: Path) -> None:
    """Write a head model; the same model gives the same bytes.

    Bases and regions are stored as float16 (a few micrometres at most), all else exactly.

    Raises:
        ModelFault: the model would not be accepted by ``load_head``.
    """
    check(model, str(path))
    header = {"format": FORMAT, **{key: getattr(model, key) for key in TEXT}}
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        _write(archive, "header", np.frombuffer(json.dumps(header, sort_keys=True).encode(), np.uint8))
        for key in STORED:
            value = getattr(model, key)
            _write(archive, key, value.astype(np.float16) if key in HALF else value)


def _write(archive: zipfile.ZipFile, key: str, value: npt.NDArray[Any]) -> None:
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.ascontiguousarray(value), version=(1, 0), allow_pickle=False)
    archive.writestr(zipfile.ZipInfo(f"{key}.npy", date_time=(1980, 1, 1, 0, 0, 0)), buffer.getvalue())
