"""An opening of the face, brought to the rim that the photo shows: between lids, or between lips.

Expression units move the edges of a mesh's opening. Here they are solved for so that the edges, as the camera sees
them, end where the landmark network found the rim.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from service.anatomy.opening_edges import Index, OpeningEdges
from service.geometry.camera import Camera
from service.head.model import HeadModel

Array = npt.NDArray[np.float64]

RIM_SIGMA_M, UNIT_SIGMA = 0.0005, 0.5
"""Standard deviations of the rim, and of a unit's activation about what was asked for before."""
LEAST_FACING = 0.35
"""Cosine between the line of sight of the head and the view below which a rim is too foreshortened to be read."""
ROUNDS = 3
"""Steps; which row of vertices bounds the opening, and where along the rim it lies, may change in each."""


@dataclass(frozen=True)
class Rim:
    """A detected rim in a frame of its own: place from its first corner (0) to the second (1), height in pixels.

    Attributes:
        corner: (2,) photo pixels of the first corner.
        along: (2,) one over pixels: a place by a difference of pixels.
        across: (2,) unit vector upwards on the head.
        upper: (K, 2) place and height along the upper edge, by place.
        lower: the same of the lower edge.
        used: places between which the edges are to end at it.
    """

    corner: Array
    along: Array
    across: Array
    upper: Array
    lower: Array
    used: tuple[float, float]

    @classmethod
    def of(cls, points: Array, up: Array, used: tuple[float, float]) -> Rim | None:
        """Of (2 K, 2) photo pixels: a corner, along the lower edge, the other corner, back along the upper edge.

        ``up`` (2,) is where the head's crown is: of closed eyes the rim does not tell. None where the points have no
        length or are not finite.
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
        """Pixels from corner to corner."""
        return 1.0 / float(np.linalg.norm(self.along))

    def lower_above(self, share: float) -> Rim:
        """With the upper edge lower by a share of the length."""
        return replace(self, upper=self.upper - [0.0, share * self.length])

    def narrower(self, height: float) -> Rim:
        """With edges closer together by a height in pixels, until they meet."""
        places = self.upper[:, 0]
        lower = np.interp(places, self.lower[:, 0], self.lower[:, 1])
        middle, half = (self.upper[:, 1] + lower) / 2, np.maximum(self.upper[:, 1] - lower - height, 0.0) / 2
        return replace(self, upper=np.stack([places, middle + half], 1), lower=np.stack([places, middle - half], 1))


@dataclass(frozen=True)
class Row:
    """A row of an edge as the camera sees it: vertices, places, heights in pixels, and pixels a metre, (N,) each."""

    own: Index
    place: Array
    height: Array
    scale: Array

    @classmethod
    def of(cls, own: Index, points: Array, camera: Camera, rim: Rim) -> Row | None:
        """The part of it that is used; None where that is not in front of the camera.

        Args:
            own: (N,) vertices.
            points: (N, 3) metres in head space.
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
        return cls(own[used], place[used], offset[used] @ rim.across, camera.focal_px / depth[used])


def brought_to(
    rim: Rim,
    edges: OpeningEdges,
    names: set[str],
    head: HeadModel,
    neutral: npt.NDArray[np.floating],
    expression: Array,
    camera: Camera,
) -> Array:
    """(E,) expression whose opening ends at a rim, all in [0, 1].

    Args:
        rim: where the edges should be seen.
        edges: of the opening.
        names: of the units that may change; those that the head lacks do not.
        head: the model.
        neutral: (V, 3) metres, the fitted head without expression.
        expression: (E,) activations before.
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
    neutral: npt.NDArray[np.floating],
    expression: Array,
    units: list[int],
    before: Array,
    camera: Camera,
    rim: Rim,
    edges: OpeningEdges,
) -> Array:
    """Activations of the units after one linear least-squares step within [0, 1]."""
    from scipy.optimize import lsq_linear

    start = expression[units]
    matrix, target = [np.eye(len(units)) / UNIT_SIGMA], [(before - start) / UNIT_SIGMA]
    for rows, curve, outwards in ((edges.upper, rim.upper, 1.0), (edges.lower, rim.lower, -1.0)):
        seen = []
        for own in rows:
            moved = np.tensordot(expression, head.expression[:, own].astype(np.float64), 1)
            row = Row.of(own, np.asarray(neutral, np.float64)[own] + moved, camera, rim)
            seen += [] if row is None else [row]
        if not seen:
            return start
        # What bounds the opening: the row of the upper edge that is lowest, of the lower one that is highest.
        edge = min(seen, key=lambda one: outwards * float(one.height.mean()))
        wanted = np.interp(edge.place, curve[:, 0], curve[:, 1])
        upwards = edge.scale[:, None] * (rim.across @ camera.rotation[:2])
        each = np.einsum("nk,unk->nu", upwards, head.expression[units][:, edge.own].astype(np.float64))
        weight = 1.0 / (np.sqrt(len(edge.own)) * RIM_SIGMA_M * edge.scale)
        matrix.append(each * weight[:, None])
        target.append((wanted - edge.height) * weight)
    solved = lsq_linear(np.vstack(matrix), np.concatenate(target), (-start - 1e-9, 1.0 - start + 1e-9))
    return np.asarray(np.clip(start + solved.x, 0.0, 1.0))
