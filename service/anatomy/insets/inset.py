"""Meshes set into the head that follow its own parts, and the file of those of the mouth."""

from __future__ import annotations

import functools
import io
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from service.arrays import AnyFloat, Float32, Int32
from service.errors import ModelFault

FILE = Path(__file__).resolve().parents[2] / "data" / "head" / "mouth.npz"
"""Teeth, gums and tongue; made by ``python -m models.people.inside``."""


@dataclass(frozen=True, eq=False)
class Inset:
    """One mesh.

    Attributes:
        name: of the part.
        rest: (N, 3) float32 metres in head space, on the head that it was made for.
        follow: (N, k) int32 vertices of the head; share: (N, k) float32 their weights, sum 1.
        faces: (F, 3) or (F, 4) int32, counter-clockwise from outside; uv_faces: the same into ``uv``.
        uv: (U, 2) float32 in [0, 1], origin bottom left.
        along: (N,) float32 in [0, 1] from the biting edge of a tooth to its gum, -1 on gums; on the tongue from the tip
            to the root.
        shade: (N,) float32 in [0, 1], 0 deep between two teeth and 1 in the open.
    """

    name: str
    rest: Float32
    follow: Int32
    share: Float32
    faces: Int32
    uv: Float32
    uv_faces: Int32
    along: Float32
    shade: Float32

    def moved(self, offsets: AnyFloat) -> Float32:
        """(N, 3) float32 metres by which it follows offsets (V, 3) of the head."""
        out = np.zeros((len(self.rest), 3))
        for k in range(self.follow.shape[1]):
            out += self.share[:, k : k + 1].astype(np.float64) * offsets[self.follow[:, k]]
        return np.asarray(out, np.float32)


@dataclass(frozen=True, eq=False)
class Insets:
    """Meshes, and the mean head (V, 3) float32 metres that they were made for."""

    meshes: tuple[Inset, ...]
    fitted_head: Float32


@functools.lru_cache(maxsize=2)
def read_insets(path: Path = FILE) -> Insets:
    """Read a file.

    Raises:
        ModelFault: it is missing or cannot be read.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
        names = list(dict.fromkeys(key.partition(":")[0] for key in arrays if ":" in key))
        keys = [field.name for field in fields(Inset) if field.name != "name"]
        meshes = tuple(Inset(name, *(arrays[f"{name}:{key}"] for key in keys)) for name in names)
        return Insets(meshes, arrays["fitted_head"])
    except FileNotFoundError:
        raise ModelFault(f"{path} is missing; build it with python -m models.people.inside --assets FOLDER") from None
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile) as fault:
        raise ModelFault(f"{path} cannot be read: {fault}") from fault


def write_insets(meshes: Sequence[Inset], fitted_head: AnyFloat, path: Path) -> None:
    """Write a file; the same meshes give the same bytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        arrays = {"fitted_head": np.asarray(fitted_head, np.float32)}
        for mesh in meshes:
            arrays |= {f"{mesh.name}:{f.name}": getattr(mesh, f.name) for f in fields(Inset) if f.name != "name"}
        for key, value in arrays.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.ascontiguousarray(value), version=(1, 0), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{key}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            archive.writestr(entry, buffer.getvalue(), zipfile.ZIP_DEFLATED)
