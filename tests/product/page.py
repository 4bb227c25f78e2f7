"""Which part of a head lies under which pixel of the page, told from the archive alone."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import trimesh

Floats = npt.NDArray[np.float64]

ROOM = 0.12
"""Room about the head, as a share of its height, while the page compares it: ``web/src/viewer/compare.ts``."""
SEE_THROUGH = ("cornea", "tears", "lash")


@dataclass(frozen=True)
class Parts:
    """Meshes of an archive with the photo's expression, and the photo's camera.

    Attributes:
        meshes: (vertices in metres, triangles) by the name of the part.
        camera: of the manifest.
    """

    meshes: dict[str, tuple[Floats, npt.NDArray[np.int64]]]
    camera: dict[str, Any]

    @classmethod
    def of(cls, archive: bytes) -> Parts:
        """Read the OBJ files."""
        with zipfile.ZipFile(io.BytesIO(archive)) as opened:
            camera = json.loads(opened.read("manifest.json"))["camera"]
            skin = _meshes(opened.read("mesh/head.obj").decode())["skin"]
            return cls({"skin": skin, **_meshes(opened.read("mesh/parts.obj").decode())}, camera)

    def pixels(self, points: Floats) -> Floats:
        """(n, 3) metres -> (n, 2) pixels of the photo."""
        x, y, z = np.array(self.camera["rotation"]) @ points.T + np.array(self.camera["translation"])[:, None]
        pixels: Floats = self.camera["focal_px"] * np.stack([x, y], 1) / z[:, None] + self.camera["principal_point"]
        return pixels

    def window(self, aspect: float) -> Floats:
        """[left, top, width, height] of what the page shows while comparing, in pixels of the photo.

        Args:
            aspect: width over height of the view.
        """
        points, faces = self.meshes["skin"]
        head = self.pixels(points[np.unique(faces)])
        low, high = head.min(0), head.max(0)
        tall = max(high[1] - low[1], (high[0] - low[0]) / aspect) * (1 + 2 * ROOM)
        corner = (low + high) / 2 - np.array([tall * aspect, tall]) / 2
        return np.array([*corner, tall * aspect, tall])

    def seen(self, size: tuple[int, int]) -> dict[str, npt.NDArray[np.bool_]]:
        """(height, width) masks of the pixels of a view that show a part, by its name.

        Args:
            size: (width, height) of the view.
        """
        width, height = size
        left, top, wide, tall = self.window(width / height)
        names = [name for name in self.meshes if not any(part in name for part in SEE_THROUGH)]
        faces, vertices, owner, first = [], [], [], 0
        for number, name in enumerate(names):
            points, triangles = self.meshes[name]
            vertices.append(points)
            faces.append(triangles + first)
            owner.append(np.full(len(triangles), number))
            first += len(points)
        scene = trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)
        y, x = np.mgrid[:height, :width] + 0.5
        photo = np.stack([left + x.ravel() / width * wide, top + y.ravel() / height * tall], 1)
        centred = (photo - self.camera["principal_point"]) / self.camera["focal_px"]
        rotation = np.array(self.camera["rotation"])
        towards = np.concatenate([centred, np.ones((len(centred), 1))], 1) @ rotation
        eye = np.tile(-rotation.T @ np.array(self.camera["translation"]), (len(towards), 1))
        hit = scene.ray.intersects_first(eye, towards)
        part = np.where(hit < 0, -1, np.concatenate(owner)[hit]).reshape(height, width)
        return {name: part == number for number, name in enumerate(names)}


def _meshes(obj: str) -> dict[str, tuple[Floats, npt.NDArray[np.int64]]]:
    """Vertices of the whole file with the triangles of each of its groups; polygons are cut into fans."""
    vertices: list[list[float]] = []
    groups: dict[str, list[list[int]]] = {}
    name = ""
    for line in obj.splitlines():
        kind, _, rest = line.partition(" ")
        if kind == "v":
            vertices.append([float(number) for number in rest.split()[:3]])
        elif kind == "g":
            name = rest
        elif kind == "f":
            corners = [int(corner.partition("/")[0]) - 1 for corner in rest.split()]
            fan = ([corners[0], corners[i], corners[i + 1]] for i in range(1, len(corners) - 1))
            groups.setdefault(name, []).extend(fan)
    points = np.array(vertices)
    return {name: (points, np.array(faces)) for name, faces in groups.items()}
