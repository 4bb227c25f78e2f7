"""Glasses and caps for heads, in metres about the middle between the eyes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from benchmarks.heads import TexturedHead
from benchmarks.render import Worn
from service.geometry.normals import vertex_normals

Float = npt.NDArray[np.float64]

FRAME = (0.02, 0.02, 0.022)
LENS_M, RIM_M = (0.026, 0.020), 0.0016
"""Half width and half height of a rim, and its thickness."""
BEFORE_EYES_M = 0.011
"""From the front of the eyeballs to the plane of the glasses."""
CAP = (0.45, 0.05, 0.06)
CAP_M, BRIM_M = 0.007, 0.055
"""How far the cap stands off the head, and its brim off the cap."""
EDGE_M, RISE = 0.047, 0.10
"""Height of the cap's edge above the eyes in front, and how much lower it is behind, metres per metre."""


def tube(points: Float, radius: float, closed: bool = False) -> tuple[Float, npt.NDArray[np.int64]]:
    """Vertices and triangles of a round tube along points (N, 3)."""
    ahead = np.roll(points, -1, 0) - np.roll(points, 1, 0)
    if not closed:
        ahead[0], ahead[-1] = points[1] - points[0], points[-1] - points[-2]
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    side = np.cross(ahead, [0.13, 0.31, 0.94])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    around = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.cos(around)[:, None] * side[:, None] + np.sin(around)[:, None] * np.cross(ahead, side)[:, None]
    vertices = (points[:, None] + radius * ring).reshape(-1, 3)
    first = np.arange(len(points) if closed else len(points) - 1)[:, None]
    here, there = first * 12, (first + 1) % len(points) * 12
    k, after = np.arange(12)[None], (np.arange(12)[None] + 1) % 12
    quads = np.stack([here + k, there + k, there + after, here + after], -1).reshape(-1, 4)
    return vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def glasses(head: TexturedHead) -> tuple[Worn, ...]:
    """Two dark rims, the bridge between them and the temples; no glass."""
    around = np.linspace(0, 2 * np.pi, 96, endpoint=False)
    front = head.eyes[:, 2].mean() + head.eye_radius + BEFORE_EYES_M
    level = np.abs(head.vertices[:, 1]) < 0.02
    temple = np.abs(head.vertices[level, 0]).max() - 0.012
    parts = []
    for eye in head.eyes:
        middle = np.array([eye[0] * 1.04, eye[1] - 0.004, front])
        rim = middle + np.stack([LENS_M[0] * np.cos(around), LENS_M[1] * np.sin(around), 0 * around], 1)
        out = np.sign(eye[0])
        hinge = middle + np.array([out * LENS_M[0], 0.006, 0.0])
        ear = np.array([out * temple, hinge[1], -0.06])
        parts += [tube(rim, RIM_M, closed=True), tube(hinge + np.linspace(0, 1, 80)[:, None] * (ear - hinge), RIM_M)]
    inner = [np.array([eye[0] * 1.04 - np.sign(eye[0]) * LENS_M[0], eye[1], front]) for eye in head.eyes]
    along = np.linspace(0, 1, 30)[:, None]
    bow = inner[0] + along * (inner[1] - inner[0]) + 0.003 * np.sin(np.pi * along) * np.array([0, 1, 1])
    parts.append(tube(bow, RIM_M))
    return tuple(Worn(vertices, triangles, FRAME, 0.2) for vertices, triangles in parts)


def cap(head: TexturedHead) -> tuple[Worn, ...]:
    """The head's own skull, moved outwards, above an edge; and a brim before it."""
    normals = vertex_normals(head.vertices, head.triangles)
    above = head.vertices[:, 1] > EDGE_M - RISE * (0.08 - head.vertices[:, 2])
    triangles = head.triangles[above[head.triangles].all(1)]
    used, own = np.unique(triangles, return_inverse=True)
    shell = Worn((head.vertices + CAP_M * normals)[used], own.reshape(-1, 3), CAP, 0.8)
    edge = head.vertices[above & (np.abs(head.vertices[:, 1] - EDGE_M) < 0.01)]
    turn = np.linspace(-1.15, 1.15, 121)
    centre, reach = np.array([0.0, EDGE_M - 0.002, edge[:, 2].max() - 0.075]), 0.072
    rows = []
    for share in np.linspace(-0.3, 1, 60):  # it begins inside the cap
        ahead = share * BRIM_M * np.cos(turn / turn[-1] * np.pi / 2)
        r = reach + ahead
        rows.append(centre + np.stack([r * np.sin(turn), -0.25 * ahead, r * np.cos(turn)], 1))
    grid = np.arange(60 * 121).reshape(60, 121)
    a, b, c, d = grid[:-1, :-1].ravel(), grid[1:, :-1].ravel(), grid[1:, 1:].ravel(), grid[:-1, 1:].ravel()
    brim = Worn(np.concatenate(rows), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]), CAP, 0.8)
    return shell, brim
