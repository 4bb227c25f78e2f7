"""The landmark embedding as a file of its own: made by ``calibrate.py``, put into the head by ``build.py``.

It is kept in terms of triangles, so it is valid for every head of the same topology whatever its identity basis or
chart.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from models.head.digest import write_digest
from models.head.writing import save_head
from service.head.model import HeadModel

EMBEDDING_FILE = Path(__file__).resolve().parent / "landmarks.npz"

CONTOUR = (
    10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377, 152, 148, 176, 149, 150,
    136, 172, 58, 132, 93, 234, 127, 162, 21, 54, 103, 67, 109,
)  # fmt: skip
"""Landmarks of MediaPipe's face oval, which slide over the surface as the head turns."""


@dataclass(frozen=True)
class Embedding:
    """The landmark fields of ``HeadModel`` under the same names."""

    landmark_triangle: npt.NDArray[np.int32]
    landmark_barycentric: npt.NDArray[np.float32]
    landmark_spread: npt.NDArray[np.float32]
    contour_landmarks: npt.NDArray[np.int32]
    contour_yaw_deg: npt.NDArray[np.float32]
    contour_triangle: npt.NDArray[np.int32]
    contour_barycentric: npt.NDArray[np.float32]

    @classmethod
    def empty(cls) -> Embedding:
        """No landmarks at all."""
        i, f = np.int32, np.float32
        return cls(
            np.zeros(0, i), np.zeros((0, 3), f), np.zeros(0, f), np.zeros(0, i), np.zeros(0, f), np.zeros((0, 0), i),
            np.zeros((0, 0, 3), f),
        )  # fmt: skip

    @classmethod
    def of(cls, head: HeadModel) -> Embedding:
        """That of a head."""
        return cls(**{one.name: getattr(head, one.name) for one in fields(cls)})

    def fields(self) -> dict[str, Any]:
        """Keyword arguments for HeadModel."""
        return {key: getattr(self, key) for key in asdict(self)}


def save_both(head: HeadModel, path: Path, embedding: Path = EMBEDDING_FILE) -> None:
    """Write a head file, its digest, and the embedding in it as a file of its own."""
    np.savez(embedding, **Embedding.of(head).fields())
    save_head(head, path)
    write_digest(path)


def load_embedding(path: Path = EMBEDDING_FILE) -> Embedding | None:
    """Read the embedding, None where it was never made."""
    if not path.is_file():
        return None
    with np.load(path, allow_pickle=False) as archive:
        return Embedding(**{key: archive[key] for key in archive.files})
