"""A head small enough to reason about: a sphere with a latitude-longitude chart, two eyes, and boards for the rest.

Every field of ``HeadModel`` is valid: mirror-symmetric, outward counter-clockwise, one 3:2 chart without overlap. The
skin is a sphere of ``RADIUS`` about ``CENTRE``; its chart is cut at the back (the ends of ``SKIN_U`` meet at -z).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from service.head.model import HeadModel

RADIUS = 0.09
CENTRE = np.array([0.0, 0.0, -0.08])
EYE_RADIUS = 0.012
EYE_X = 0.031
SKIN_U = (0.02, 0.98)
SKIN_V = (0.27, 0.98)
PARTS = ("skin", "eye_left", "eye_right", "teeth_upper", "teeth_lower", "tongue", "lashes")

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Patch = tuple[Array, Ints, Array, Ints]
"""Vertices, quads (-1 marks a triangle), uv, quads into uv."""


def _ball(centre: Array, radius: float, rings: int, segments: int, box: tuple[float, float, float, float]) -> Patch:
    """Sphere whose longitude runs along u and latitude along v of ``box`` (u0, v0, u1, v1); the cut is at -z."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    longitude = np.linspace(-np.pi, np.pi, segments + 1)
    lat, lon = np.meshgrid(latitude[1:-1], longitude[:-1], indexing="ij")
    body = np.stack([np.cos(lat) * np.sin(lon), np.sin(lat), np.cos(lat) * np.cos(lon)], -1).reshape(-1, 3)
    vertices = np.vstack([body, [[0, -1, 0], [0, 1, 0]]]) * radius + centre
    south, north = len(body), len(body) + 1

    u = box[0] + (box[2] - box[0]) * np.arange(segments + 1) / segments
    v = box[1] + (box[3] - box[1]) * np.arange(rings + 1) / rings
    grid = np.stack(np.meshgrid(u, v), -1)  # ring-major, segments + 1 per ring
    grid[[0, -1], :, 0] += 0.5 * (u[1] - u[0])  # each triangle at a pole has its tip in its middle
    uv = grid.reshape(-1, 2)
    quads, quads_uv = [], []
    for ring in range(rings):
        for s in range(segments):
            low, high = ring * (segments + 1) + s, (ring + 1) * (segments + 1) + s
            at = [((ring - 1) * segments + k % segments, ring * segments + k % segments) for k in (s, s + 1)]
            if ring == 0:
                quads.append([south, at[1][1], at[0][1], -1])
                quads_uv.append([low, high + 1, high, -1])
            elif ring == rings - 1:
                quads.append([at[0][0], at[1][0], north, -1])
                quads_uv.append([low, low + 1, high, -1])
            else:
                quads.append([at[0][0], at[1][0], at[1][1], at[0][1]])
                quads_uv.append([low, low + 1, high + 1, high])
    return vertices, np.array(quads), uv, np.array(quads_uv)


def _board(height: float, box: tuple[float, float, float, float]) -> Patch:
    """Two quads that face +z within the ball, symmetric about x = 0."""
    x, y = np.meshgrid([-0.02, 0.0, 0.02], [height - 0.002, height + 0.002])
    vertices = np.stack([x.ravel(), y.ravel(), np.full(6, -0.02)], 1)
    u, v = np.meshgrid([box[0], (box[0] + box[2]) / 2, box[2]], [box[1], box[3]])
    quads = np.array([[0, 1, 4, 3], [1, 2, 5, 4]])
    return vertices, quads, np.stack([u.ravel(), v.ravel()], 1), quads


def _join(patches: list[Patch]) -> tuple[Array, Ints, Array, Ints, npt.NDArray[np.uint8]]:
    vertices, quads, uv, quads_uv, part = [], [], [], [], []
    at = at_uv = 0
    for index, (v, q, t, qt) in enumerate(patches):
        vertices.append(v)
        uv.append(t)
        quads.append(np.where(q < 0, -1, q + at))
        quads_uv.append(np.where(qt < 0, -1, qt + at_uv))
        part.append(np.full(len(q), index, np.uint8))
        at, at_uv = at + len(v), at_uv + len(t)
    return np.vstack(vertices), np.vstack(quads), np.vstack(uv), np.vstack(quads_uv), np.concatenate(part)


def _split(quads: Ints) -> tuple[Ints, Ints]:
    """Triangles of the polygons and the polygon that each comes from."""
    whole = np.flatnonzero(quads[:, 3] >= 0)
    triangles = np.vstack([quads[:, :3], quads[whole][:, [0, 2, 3]]])
    return triangles, np.concatenate([np.arange(len(quads)), whole])


def _mirror(vertices: Array) -> Ints:
    """Partner of each vertex: the nearest one to its reflection (exact here)."""
    return np.asarray(cKDTree(vertices).query(vertices * [-1.0, 1.0, 1.0])[1])


def sphere_head(rings: int = 24, segments: int = 48) -> HeadModel:
    """The toy head. ``segments`` even, so that a column of vertices lies on the midline in front and at the back."""
    left = (0.55, 0.03, 0.78, 0.23)
    # Boards must map to themselves under u <-> 1 - u, so they sit in the middle of the chart's lower band.
    boards = [_board(-0.03 - 0.005 * i, (0.46, 0.03 + 0.05 * i, 0.54, 0.06 + 0.05 * i)) for i in range(4)]
    patches = [
        _ball(CENTRE, RADIUS, rings, segments, (SKIN_U[0], SKIN_V[0], SKIN_U[1], SKIN_V[1])),
        _ball(np.array([EYE_X, 0, 0]), EYE_RADIUS, 8, 12, left),
        _ball(np.array([-EYE_X, 0, 0]), EYE_RADIUS, 8, 12, (1 - left[2], left[1], 1 - left[0], left[3])),
        *boards,
    ]
    vertices, quads, uv, quads_uv, part = _join(patches)
    triangles, owner = _split(quads)
    triangles_uv, _ = _split(quads_uv)
    skin = np.flatnonzero(part[owner] == 0)
    front = skin[np.argsort(-vertices[triangles[skin]].mean(1)[:, 2], kind="stable")]
    landmarks = np.sort(front[np.linspace(0, len(front) // 3, 468).astype(int)])
    rim = np.arange(0, 468, 13)
    bins = np.array([-45.0, 0.0, 45.0], np.float32)
    below = np.clip(-vertices[:, 1] / RADIUS, 0, 1)[:, None]
    front_weight = np.clip((vertices[:, 2] - CENTRE[2]) / RADIUS, 0, 1).astype(np.float32)
    return HeadModel(
        name="toy sphere",
        licence="CC0-1.0",
        mean=vertices.astype(np.float32),
        identity=np.stack([vertices * [0.04, 0, 0], vertices * [0, 0.05, 0]]).astype(np.float32),
        expression=np.stack([below * [0, -0.01, 0], below * np.sign(vertices[:, :1]) * [0.004, 0, 0]]).astype(
            np.float32
        ),
        expression_names=("jawOpen", "mouthStretchLeft"),
        polygons=quads.astype(np.int32),
        polygon_uv=quads_uv.astype(np.int32),
        polygon_part=part,
        part_names=PARTS,
        uv=uv.astype(np.float32),
        mirror=_mirror(vertices).astype(np.int32),
        triangles=triangles.astype(np.int32),
        triangle_uv=triangles_uv.astype(np.int32),
        triangle_part=part[owner],
        landmark_triangle=landmarks.astype(np.int32),
        landmark_barycentric=np.full((468, 3), 1 / 3, np.float32),
        landmark_spread=np.full(468, 0.001, np.float32),
        contour_landmarks=rim.astype(np.int32),
        contour_yaw_deg=bins,
        contour_triangle=np.tile(landmarks[rim], (3, 1)).astype(np.int32),
        contour_barycentric=np.full((3, len(rim), 3), 1 / 3, np.float32),
        region_names=("face", "scalp"),
        regions=np.stack([front_weight, 1 - front_weight]),
    )
