"""Heads with textures of the skin's colour and relief, so that a photo of them can be sharper than a mesh.

- ``scan``: Lee Perry-Smith's head with its own colours and normals, 2.7 texels a millimetre.
- ``hifi3d 1`` to ``3``: skins of hifi3d, 7.6 texels a millimetre, on heads of ICT-FaceKit.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.corrections.sitters import HIFI3D, whole_skin
from benchmarks.heads import EYE_RADIUS_M, IctHeads, Skin, subdivided
from benchmarks.shoot import FFHQ_EYES_M, ffhq_head, ict_places, landmarks_on
from benchmarks.subjects import BEHIND_LIDS_M, PUPILS_M, SCAN_LIDS
from models.lightstage.references import linear, normals, read

Float = npt.NDArray[np.float64]

SHAPES = {"hifi3d 1": 100, "hifi3d 2": 102, "hifi3d 3": 103}
"""Seed of the head of ICT-FaceKit that wears each skin."""
NAMES = ("scan", *SHAPES)
LIDS_M, LIPS_M = 0.021, 0.012
"""Distance from eyeballs' centres and from the lips' outline within which a carried skin does not fit."""
SMOOTHED = 12
"""Rounds in which the places on the chart, which were carried vertex by vertex, are brought nearer to their
neighbours': else the texture would be crumpled."""


@dataclass(frozen=True)
class Sitter:
    """One head.

    Attributes:
        name: one of ``NAMES``.
        vertices: (V, 3) metres, +Y up, +Z forward, origin between the eyes.
        triangles: (T, 3).
        uv: (V, 2), origin at the bottom left.
        albedo: (H, W, 3) linear RGB.
        normal: (H', W', 3) unit, tangent space, +Y up.
        eyes: (2, 3) eyeball centres, subject's left first.
        eye_radius: metres.
        unfit: (K, 4) centres and radii, metres, of balls in which a carried skin does not fit: lids and lips.
    """

    name: str
    vertices: Float
    triangles: npt.NDArray[np.int64]
    uv: Float
    albedo: Float
    normal: Float
    eyes: Float
    eye_radius: float
    unfit: Float


def sitter(name: str, data: Path, out: Path) -> Sitter:
    """A head out of the folder ``data`` of reference heads; ``out`` keeps what takes long to make.

    Raises:
        KeyError: the name is none of ``NAMES``.
        UsageError: a file is missing.
    """
    return _scan(data) if name == "scan" else _carried(name, data, out)


def _scan(data: Path) -> Sitter:
    import trimesh

    folder = data / "lee_perry_smith"
    mesh: Any = trimesh.load(folder / "head.glb", force="mesh", process=False)
    # The file counts v from the bottom, where glTF counts it from the top.
    uv = np.asarray(mesh.visual.uv, np.float64) * [1, -1] + [0, 1]
    metres = PUPILS_M / float(np.linalg.norm(SCAN_LIDS[0] - SCAN_LIDS[1]))
    eyes = metres * SCAN_LIDS - [0, 0, BEHIND_LIDS_M]
    vertices, triangles = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    colour, relief = linear(read(folder / "color.jpg")), normals(read(folder / "normal.jpg"))
    middle = eyes.mean(0)
    return Sitter("scan", metres * vertices - middle, triangles, uv, colour, relief, eyes - middle, 0.0115,
                  np.zeros((0, 4)))  # fmt: skip


def _carried(name: str, data: Path, out: Path) -> Sitter:
    skin, ict = Skin.load(data / "ffhq_uv_head"), IctHeads(data / "ict_facekit_head.npz")
    cached = (out / "places.npy").is_file()
    landmarks = np.zeros((0, 3)) if cached else landmarks_on(ffhq_head(skin), out, "reference_skin")
    places = ict_places(ict, skin, landmarks, FFHQ_EYES_M.mean(0), out)
    vertices, eyes = ict.sample(SHAPES[name])
    fine, triangles = subdivided(vertices, ict.triangles, 2)
    albedo = whole_skin(linear(read(data / "hifi3d_uv" / HIFI3D[name])), skin.texture)
    relief = normals(read(data / "hifi3d_uv" / HIFI3D[name].replace("albedo", "normal")))
    flat = relief[..., 2] < 0.2  # beside the face the file is black
    relief[flat] = (0.0, 0.0, 1.0)
    mouth = vertices[ict.landmarks[48:60]]
    balls = [*((eye, LIDS_M) for eye in eyes), *((corner, LIPS_M) for corner in mouth)]
    unfit = np.array([[*centre, radius] for centre, radius in balls])
    return Sitter(name, fine, triangles, smoothed(places, triangles), albedo, relief, eyes, EYE_RADIUS_M, unfit)


def smoothed(values: Float, triangles: npt.NDArray[np.int64], rounds: int = SMOOTHED) -> Float:
    """(V, C) values, each brought to the mean of itself and its neighbours' mean, ``rounds`` times; borders stay."""
    from scipy.sparse import coo_matrix, diags

    count = len(values)
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    both = np.concatenate([sides, sides[:, ::-1]])
    once = coo_matrix((np.ones(len(both)), both.T), (count, count)).tocsr()
    border = np.unique(np.argwhere(once == 1).ravel()) if once.nnz else np.zeros(0, int)
    once.data[:] = 1
    mean = diags(1 / np.maximum(np.asarray(once.sum(1)).ravel(), 1)) @ once
    result = values.copy()
    for _ in range(rounds):
        nearer = 0.5 * (result + mean @ result)
        nearer[border] = values[border]
        result = nearer
    return result
