"""Lids where the photo has them, after pose, shape and gaze are known.

The landmark fit knows a lid to two millimetres, and the heads of the model look out of narrower eyes than people do: an
iris that the photo shows would lie on a lid, and the lashes above it. So the edge of each lid, as the camera sees it,
is brought to the rim that the landmark network found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.fit.gaze import LIDS, RIMS, SIDES
from service.geometry.camera import Camera
from service.head.lid_edges import Index, LidEdges
from service.head.model import HeadModel

Array = npt.NDArray[np.float64]

BEFORE_LASHES_M = 0.0002
"""The network's upper rim lies on the roots of the lashes, this much above the opening."""
USED = (0.12, 0.88)
"""Part of the way from the outer corner of the eye to the inner where lids have a height."""
RIM_SIGMA_M, UNIT_SIGMA = 0.0005, 0.5
"""Standard deviations of the rim, and of a unit's activation about what landmarks and gaze asked for."""
LEAST_FACING = 0.35
"""Cosine between the line of sight of the head and the view below which a rim is too foreshortened to be read."""
ROUNDS = 3
"""Steps; which row of vertices bounds the opening, and where along the rim it lies, may change in each."""


@dataclass(frozen=True)
class Rim:
    """The detected rim of one eye in a frame of its own: place from outer (0) to inner corner (1), height in pixels.

    Attributes:
        outer: (2,) photo pixels of the outer corner.
        along: (2,) one over pixels: a place by a difference of pixels.
        across: (2,) unit vector towards the brow.
        upper: (K, 2) place and height along the upper lid, by place.
        lower: the same of the lower lid.
    """

    outer: Array
    along: Array
    across: Array
    upper: Array
    lower: Array

    @classmethod
    def of(cls, points: Array, up: Array) -> Rim | None:
        """Of (16, 2) photo pixels in the order of ``RIMS``; None where they have no length or are not finite.

        ``up`` (2,) is where the head's brow is: of closed eyes the rim does not tell.
        """
        half = len(points) // 2
        outer, inner = points[0], points[half]
        length = float(np.linalg.norm(inner - outer))
        if not np.isfinite(points).all() or length < 1e-6:
            return None
        along = (inner - outer) / length
        across = np.array([along[1], -along[0]])
        across *= np.sign(float(across @ up)) or 1.0
        curves = []
        for between in (points[half + 1 :], points[1:half]):
            offset = np.vstack([outer, between, inner]) - outer
            curve = np.stack([offset @ along / length, offset @ across], 1)
            curves.append(curve[np.argsort(curve[:, 0], kind="stable")])
        return cls(outer, along / length, across, curves[0], curves[1])


@dataclass(frozen=True)
class Row:
    """A row of a lid's vertices as the camera sees it: vertices, places, heights in pixels, and pixels a metre (N,)."""

    own: Index
    place: Array
    height: Array
    scale: Array

    @classmethod
    def of(cls, own: Index, points: Array, camera: Camera, rim: Rim) -> Row | None:
        """The part of it where lids have a height; None where that is not in front of the camera.

        Args:
            own: (N,) vertices.
            points: (N, 3) metres in head space.
            camera: of the fit.
            rim: the detected one.
        """
        depth = camera.to_camera(points)[:, 2]
        if (depth <= 1e-6).any():
            return None
        offset = camera.project(points) - rim.outer
        place = offset @ rim.along
        used = (place > USED[0]) & (place < USED[1])
        if used.sum() < 3:
            return None
        return cls(own[used], place[used], offset[used] @ rim.across, camera.focal_px / depth[used])


def lids_on_rims(
    head: HeadModel,
    neutral: npt.NDArray[np.floating],
    expression: Array,
    camera: Camera,
    landmarks: npt.NDArray[np.floating],
) -> Array:
    """(E,) expression whose lids end where the rims of the photo's eyes are, all in [0, 1].

    Args:
        head: the model; eyes without lids, lid units or a rim to be read keep what they have.
        neutral: (V, 3) metres, the fitted head without expression.
        expression: (E,) activations of landmarks and gaze.
        camera: of the fit.
        landmarks: (468, >= 2) photo pixels.
    """
    out = np.array(expression, np.float64)
    if not -camera.rotation[2, 2] >= LEAST_FACING:
        return out
    for side in SIDES:
        wanted = {f"{unit}{side.capitalize()}" for unit in LIDS}
        units = [k for k, name in enumerate(head.expression_names) if name in wanted]
        edges = LidEdges.of(head, side)
        rim = Rim.of(np.asarray(landmarks, np.float64)[list(RIMS[side]), :2], camera.rotation[:2, 1])
        if edges is None or rim is None or not units:
            continue
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
    edges: LidEdges,
) -> Array:
    """Activations of the units after one linear least-squares step within [0, 1]."""
    from scipy.optimize import lsq_linear

    start = expression[units]
    matrix, target = [np.eye(len(units)) / UNIT_SIGMA], [(before - start) / UNIT_SIGMA]
    for lid, curve, inset, outwards in (
        (edges.upper, rim.upper, BEFORE_LASHES_M, 1.0),
        (edges.lower, rim.lower, 0.0, -1.0),
    ):
        seen = []
        for own in lid:
            moved = np.tensordot(expression, head.expression[:, own].astype(np.float64), 1)
            row = Row.of(own, np.asarray(neutral, np.float64)[own] + moved, camera, rim)
            seen += [] if row is None else [row]
        if not seen:
            return start
        # What bounds the opening: the row of the upper lid that is lowest, of the lower one that is highest.
        edge = min(seen, key=lambda one: outwards * float(one.height.mean()))
        wanted = np.interp(edge.place, curve[:, 0], curve[:, 1]) - inset * edge.scale
        upwards = edge.scale[:, None] * (rim.across @ camera.rotation[:2])
        each = np.einsum("nk,unk->nu", upwards, head.expression[units][:, edge.own].astype(np.float64))
        weight = 1.0 / (np.sqrt(len(edge.own)) * RIM_SIGMA_M * edge.scale)
        matrix.append(each * weight[:, None])
        target.append((wanted - edge.height) * weight)
    solved = lsq_linear(np.vstack(matrix), np.concatenate(target), (-start - 1e-9, 1.0 - start + 1e-9))
    return np.asarray(np.clip(start + solved.x, 0.0, 1.0))
