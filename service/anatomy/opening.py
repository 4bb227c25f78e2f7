"""Fit an opening of the face, between lids or between lips, to the rim that the photo shows.

Expression units move the edges of the mesh's opening. Their activations are solved for by least squares so that the
edges, as the camera sees them, lie on the rim that the landmark network found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.anatomy.opening_edges import OpeningEdges
from service.arrays import AnyFloat, Float64, Int64
from service.geometry.camera import Camera
from service.head.model import HeadModel

RIM_SIGMA_M, UNIT_SIGMA = 0.0005, 0.5
"""Standard deviations of the least squares: of the rim in metres, and of a unit's activation about its prior, the value
before."""

LEAST_FACING = 0.35
"""Cosine of the angle between the head's forward axis and the view below which a rim is too foreshortened to fit."""

ROUNDS = 3
"""Least-squares steps: which row of vertices bounds the opening, and its place along the rim, may change in each."""


@dataclass(frozen=True)
class Rim:
    """A detected rim in its own frame: place from its first corner (0) to the second (1), and height in pixels.

    Attributes:
        corner: (2,) photo pixels of the first corner.
        along: (2,) in 1/pixel: its product with an offset from the corner is the place.
        across: (2,) unit vector in photo pixels, upwards on the head: its product with that offset is the height.
        upper: (K, 2) places and heights of the upper edge, sorted by place.
        lower: the same of the lower edge.
        used: places between which edges are fitted to it.
    """

    corner: Float64
    along: Float64
    across: Float64
    upper: Float64
    lower: Float64
    used: tuple[float, float]

    @classmethod
    def of(cls, points: Float64, up: Float64, used: tuple[float, float]) -> Rim | None:
        """From detected points, or None where they are not finite or the corners coincide.

        Args:
            points: (2 K, 2) photo pixels: a corner, along the lower edge, the other corner, back along the upper edge.
            up: (2,) direction towards the head's crown: the rim of closed eyes alone does not tell it.
            used: see the attribute.
        """
        half = len(points) // 2
        first, last = points[0], points[half]
        length = float(np.linalg.norm(last - first))
        if not np.isfinite(points).all() or length < 1e-6:
            return None
        along = (last - first) / length
        across = np.array([along[1], -along[0]])
        across *= np.sign(float(across @ up)) or 1.0
        curves = []
        for between in (points[half + 1 :], points[1:half]):
            offset = np.vstack([first, between, last]) - first
            curve = np.stack([offset @ along / length, offset @ across], 1)
            curves.append(curve[np.argsort(curve[:, 0], kind="stable")])
        return cls(first, along / length, across, curves[0], curves[1], used)

    @property
    def length(self) -> float:
        """Distance between the corners in pixels."""
        return 1.0 / float(np.linalg.norm(self.along))

    def lower_above(self, share: float) -> Rim:
        """The rim with its upper edge lowered by a share of the length."""
        return replace(self, upper=self.upper - [0.0, share * self.length])

    def narrower(self, height: float) -> Rim:
        """The rim with its edges moved towards each other by ``height`` pixels in all, at most until they meet."""
        places = self.upper[:, 0]
        lower = np.interp(places, self.lower[:, 0], self.lower[:, 1])
        middle, half = (self.upper[:, 1] + lower) / 2, np.maximum(self.upper[:, 1] - lower - height, 0.0) / 2
        return replace(self, upper=np.stack([places, middle + half], 1), lower=np.stack([places, middle - half], 1))


@dataclass(frozen=True)
class Row:
    """A row of vertices of an edge as the camera sees it, (N,) each.

    Attributes:
        vertices: their indices.
        place: in the frame of the rim.
        height: pixels, in the frame of the rim.
        scale: photo pixels per metre at their depth.
    """

    vertices: Int64
    place: Float64
    height: Float64
    scale: Float64

    @classmethod
    def of(cls, vertices: Int64, points: Float64, camera: Camera, rim: Rim) -> Row | None:
        """The vertices within ``rim.used``; None where fewer than 3 are, or one lies behind the camera.

        Args:
            vertices: (N,) indices.
            points: (N, 3) their positions in metres, head space.
            camera: of the fit.
            rim: the detected one.
        """
        depth = camera.to_camera(points)[:, 2]
        if (depth <= 1e-6).any():
            return None
        offset = camera.project(points) - rim.corner
        place = offset @ rim.along
        used = (place > rim.used[0]) & (place < rim.used[1])
        if used.sum() < 3:
            return None
        return cls(vertices[used], place[used], offset[used] @ rim.across, camera.focal_px / depth[used])


def fit_to_rim(
    rim: Rim,
    edges: OpeningEdges,
    names: set[str],
    head: HeadModel,
    neutral: AnyFloat,
    expression: Float64,
    camera: Camera,
) -> Float64:
    """(E,) expression, all in [0, 1], whose opening ends at a rim.

    Args:
        rim: where the edges should be seen.
        edges: of the opening.
        names: of the units that may change; names that the head lacks are ignored.
        head: the model.
        neutral: (V, 3) metres, the fitted head without expression.
        expression: (E,) activations to start from.
        camera: of the fit.
    """
    out = np.array(expression, np.float64)
    units = [k for k, name in enumerate(head.expression_names) if name in names]
    if not units or not -camera.rotation[2, 2] >= LEAST_FACING:
        return out
    before = out[units].copy()
    for _ in range(ROUNDS):
        out[units] = _step(head, neutral, out, units, before, camera, rim, edges)
    return out


def _step(
    head: HeadModel,
    neutral: AnyFloat,
    expression: Float64,
    units: list[int],
    before: Float64,
    camera: Camera,
    rim: Rim,
    edges: OpeningEdges,
) -> Float64:
    """Activations of the units after one linear least-squares step within [0, 1]."""
    from scipy.optimize import lsq_linear

    start = expression[units]
    matrix, target = [np.eye(len(units)) / UNIT_SIGMA], [(before - start) / UNIT_SIGMA]
    for rows, curve, outwards in ((edges.upper, rim.upper, 1.0), (edges.lower, rim.lower, -1.0)):
        seen = []
        for vertices in rows:
            moved = np.tensordot(expression, head.expression[:, vertices].astype(np.float64), 1)
            row = Row.of(vertices, np.asarray(neutral, np.float64)[vertices] + moved, camera, rim)
            seen += [] if row is None else [row]
        if not seen:
            return start
        # The row that bounds the opening: the lowest of the upper edge, the highest of the lower edge.
        edge = min(seen, key=lambda one: outwards * float(one.height.mean()))
        wanted = np.interp(edge.place, curve[:, 0], curve[:, 1])
        upwards = edge.scale[:, None] * (rim.across @ camera.rotation[:2])
        jacobian = np.einsum("nk,unk->nu", upwards, head.expression[units][:, edge.vertices].astype(np.float64))
        weight = 1.0 / (np.sqrt(len(edge.vertices)) * RIM_SIGMA_M * edge.scale)
        matrix.append(jacobian * weight[:, None])
        target.append((wanted - edge.height) * weight)
    solved = lsq_linear(np.vstack(matrix), np.concatenate(target), (-start - 1e-9, 1.0 - start + 1e-9))
    return np.asarray(np.clip(start + solved.x, 0.0, 1.0))
