"""Reading MakeHuman's assets: a mesh (``.obj``) and what binds it to the base mesh (``.mhclo``)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from service.errors import ModelFault

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Binding:
    """How an asset's vertices follow the base mesh.

    Attributes:
        corners: (N, 3) vertices of the base mesh.
        weights: (N, 3) their weights, sum 1.
        offset: (N, 3) in the unit of the base mesh, before scaling.
        scales: for x, y and z: two vertices of the base mesh and the distance along the axis that means a scale of 1.
    """

    corners: Int
    weights: Float
    offset: Float
    scales: tuple[tuple[int, int, float], ...]

    def place(self, body: Float) -> Float:
        """(N, 3) vertices of the asset on a body (19158, 3), in its unit."""
        scale = [abs(body[a, i] - body[b, i]) / d if d else 1.0 for i, (a, b, d) in enumerate(self.scales)]
        return np.asarray(np.einsum("nk,nkc->nc", self.weights, body[self.corners]) + self.offset * scale)


def read_binding(path: Path) -> Binding:
    """Read a ``.mhclo`` file.

    Raises:
        ModelFault: it binds no vertex.
    """
    scales = {"x_scale": (0, 0, 0.0), "y_scale": (0, 0, 0.0), "z_scale": (0, 0, 0.0)}
    corners: list[list[int]] = []
    rest: list[list[float]] = []
    begun = False
    for line in path.read_text(encoding="utf-8").splitlines():
        words = line.split()
        if not words or words[0] == "#":
            continue
        if words[0] in scales:
            scales[words[0]] = (int(words[1]), int(words[2]), float(words[3]))
        elif words[0] == "verts":
            begun = True
        elif words[0] == "delete_verts":
            break
        elif begun and words[0].lstrip("-").isdigit():
            one = len(words) == 1
            corners.append([int(words[0])] * 3 if one else [int(w) for w in words[:3]])
            rest.append([1.0, 0, 0, 0, 0, 0] if one else [float(w) for w in words[3:9]])
    if not corners:
        raise ModelFault(f"{path} binds no vertex to the base mesh")
    table = np.array(rest)
    return Binding(np.array(corners), table[:, :3], table[:, 3:], tuple(scales[k + "_scale"] for k in "xyz"))


@dataclass(frozen=True)
class Shape:
    """A mesh whose vertices are split where its texture coordinates are.

    Attributes:
        source: (M,) vertex of the file that each vertex is a copy of.
        uv: (M, 2) texture coordinates, origin bottom left.
        triangles: (T, 3).
    """

    source: Int
    uv: Float
    triangles: Int


def read_shape(path: Path) -> Shape:
    """Read the faces of an ``.obj`` file."""
    uv: list[list[float]] = []
    faces: list[list[tuple[int, int]]] = []
    for line in path.read_text(encoding="utf-8").splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == "vt":
            uv.append([float(w) for w in words[1:3]])
        elif words[0] == "f":
            corners = [w.split("/") for w in words[1:]]
            faces.append([(int(c[0]) - 1, int(c[1]) - 1 if len(c) > 1 and c[1] else 0) for c in corners])
    triangles = [(f[0], f[k], f[k + 1]) for f in faces for k in range(1, len(f) - 1)]
    pairs, index = np.unique(np.array(triangles).reshape(-1, 2), axis=0, return_inverse=True)
    table = np.array(uv) if uv else np.zeros((1, 2))
    return Shape(pairs[:, 0], table[pairs[:, 1]], index.reshape(-1, 3))
