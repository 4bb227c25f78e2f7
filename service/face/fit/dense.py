"""What the reader saw, as terms of the fit: where places of the head lie in the photo, and how they are turned.

Dense landmarks with a Gaussian uncertainty each (Wood et al., "3D face reconstruction with dense landmarks", ECCV 2022)
and per-pixel chart coordinates and normals (Giebenhain et al., "Pixel3DMM", 2025), in the same normal equations as the
landmarks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from service.arrays import AnyFloat, AnyInt, Float32, Float64, Int32
from service.face.fit.landmark_fit import at_barycentric, linear_points
from service.face.fit.solver import POSE, PointTerm, Residuals, State, linear, project_points
from service.face.reading.part_labels import READ
from service.face.reading.reader import CELLS, Reading
from service.geometry.camera import nearest_rotation, skew
from service.geometry.chart import Chart
from service.geometry.mesh import area_normals, cross
from service.head.model import HeadModel
from service.robust import geman_mcclure

if TYPE_CHECKING:  # loaded only where a face is fitted
    from scipy.sparse import csr_array

POINT_SHARE, NORMAL_SHARE = 0.04, 0.01
"""Weight of one cell beside its stated uncertainty: errors of neighbours are alike."""
FLOOR_MM, FLOOR_SINE = 1.5, 0.05
"""Added to the stated standard deviations: what the network cannot know about itself."""
GATE = 3.0
"""Standard deviations at which a cell's say is quartered (Geman and McClure)."""


@dataclass(frozen=True)
class Correspondences:
    """Places of the head that the reader found in the photo.

    Attributes:
        corners: (N, 3) int32 vertices of the triangle that holds the place; weights: (N, 3) barycentric.
        pixels: (N, 2) relative to the principal point.
        sigma_mm: (N,) > 0 on the face.
        normal: (N, 3) unit, camera axes; sine: (N,) > 0 standard deviation of its components.
        sure: (N,) in (0, 1] probability of a part whose coordinates are learnt.
    """

    corners: Int32
    weights: Float64
    pixels: Float64
    sigma_mm: Float64
    normal: Float64
    sine: Float64
    sure: Float64


def correspondences(head: HeadModel, reading: Reading, state: State, middle: Float64) -> Correspondences:
    """The cells of a reading that show the skin of the head.

    Args:
        head: any head of the reader's chart.
        reading: of the photo.
        state: gives the focal length.
        middle: (2,) principal point, photo pixels.
    """
    share = reading.parts[..., list(READ)].sum(-1).astype(np.float32)
    share = np.asarray(cv2.resize(share, (CELLS, CELLS), interpolation=cv2.INTER_AREA), np.float64)
    uv = reading.chart
    # Least probability of the parts whose chart coordinates are learnt, from which a cell is used.
    usable = (share > 0.6) & np.isfinite(uv).all(-1) & ((uv > 0) & (uv < 1)).all(-1)
    usable &= np.isfinite(reading.chart_mm) & np.isfinite(reading.normal).all(-1) & np.isfinite(reading.normal_sine)
    triangle, weights = _places(head, uv[usable])
    there = triangle >= 0
    focal = float(np.exp(state.log_scale + state.log_distance))
    normal = reading.camera_normals(focal, middle)[usable][there]
    return Correspondences(
        head.triangles[triangle[there]], weights[there], (reading.cells[usable.ravel()] - middle)[there],
        np.hypot(reading.chart_mm[usable][there], FLOOR_MM), normal,
        np.hypot(reading.normal_sine[usable][there], FLOOR_SINE), share[usable][there],
    )  # fmt: skip


def _places(head: HeadModel, uv: Float64) -> tuple[npt.NDArray[np.int64], Float64]:
    """(N,) skin triangle that holds each chart coordinate (N, 2), -1 where none does, and (N, 3) its weights there."""
    # Texels in which the triangle of a chart coordinate is looked up; the place in it is exact.
    width, height = (768, 512)
    chart = Chart.build(head, width, height)
    column = np.clip((uv[:, 0] * width).astype(int), 0, width - 1)
    row = np.clip(((1.0 - uv[:, 1]) * height).astype(int), 0, height - 1)
    triangle = chart.triangle[row, column].astype(np.int64)
    triangle[chart.part[row, column] != head.part_names.index("skin")] = -1
    a, b, c = np.moveaxis(head.uv[head.triangle_uv[np.maximum(triangle, 0)]].astype(np.float64), 1, 0)
    d1, d2, p = b - a, c - a, uv - a
    area = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]
    triangle[np.abs(area) < 1e-14] = -1
    area = np.where(np.abs(area) < 1e-14, 1.0, area)
    w1 = (p[:, 0] * d2[:, 1] - p[:, 1] * d2[:, 0]) / area
    w2 = (d1[:, 0] * p[:, 1] - d1[:, 1] * p[:, 0]) / area
    # The texel's triangle may be a neighbour of the coordinate's own.
    weights = np.clip(np.stack([1.0 - w1 - w2, w1, w2], 1), -0.5, 1.5)
    return triangle, weights / weights.sum(1, keepdims=True)


@dataclass(frozen=True)
class NormalTerm(Residuals):
    """Difference between the head's normals and the read ones; exact in the rotation, linearised in the shape.

    Attributes:
        normal: (N, 3) unit, head space, at the start; modes: (N, 3, M) its derivative by the coefficients.
        start: (M,) coefficients of the linearisation.
        target: (N, 3) unit, camera space.
        precision: (N,) >= 0.
    """

    normal: Float64
    modes: Float32
    start: Float64
    target: Float64
    precision: Float64

    def _normals(self, state: State) -> Float64:
        return np.asarray(linear(self.normal, self.modes, state.coefficients - self.start) @ state.rotation.T)

    def residual(self, state: State) -> Float64:
        """(N, 3)."""
        return self._normals(state) - self.target

    def slopes(self, state: State) -> tuple[Float64, Float64, Float64]:
        """(N, 3), (N, 3, 7) and (N, 3, 3)."""
        turned, by_pose = self._normals(state), np.zeros((len(self.normal), 3, POSE))
        by_pose[..., :3] = -skew(turned)
        return turned - self.target, by_pose, np.broadcast_to(state.rotation, by_pose[..., :3].shape)


def normal_derivative(vertices: Float64, triangles: AnyInt, chosen: npt.NDArray[np.intp]) -> csr_array:
    """(3 N, 3 V) derivative of the area-weighted unit normals of chosen vertices by the places of all.

    Args:
        vertices: (V, 3) metres.
        triangles: (T, 3).
        chosen: (N,) vertex indices; a vertex without area gets zero.
    """
    from scipy.sparse import csr_array

    row_of = np.full(len(vertices), -1)
    row_of[chosen] = np.arange(len(chosen))
    triangle, corner = np.nonzero(row_of[triangles] >= 0)
    row, near = row_of[triangles[triangle, corner]], triangles[triangle]
    a, b, c = vertices[near].transpose(1, 0, 2)
    area = cross(b - a, c - a)
    total = np.stack([np.bincount(row, area[:, k], len(chosen)) for k in range(3)], 1)
    length = np.linalg.norm(total, axis=1)
    flat = length < 1e-15
    unit = total / np.where(flat, 1.0, length)[:, None]
    along = (np.eye(3) - unit[:, :, None] * unit[:, None]) / np.where(flat, np.inf, length)[:, None, None]
    # The area vector is a x b + b x c + c x a.
    change = along[row] @ np.concatenate([skew(c - b), skew(a - c), skew(b - a)], 2)
    rows, columns = 3 * row[:, None] + np.arange(3), (3 * near[:, :, None] + np.arange(3)).reshape(-1, 9)
    index = (np.repeat(rows, 9, 1).ravel(), np.tile(columns, 3).ravel())
    return csr_array((change.astype(np.float32).ravel(), index), (3 * len(chosen), vertices.size))


class DenseTerms:
    """The terms of one reading for one head model.

    Args:
        head: whose identity is fitted whole (``service.face.fit.landmark_fit.extended`` cuts and extends it).
        found: what the reader found.
    """

    def __init__(self, head: HeadModel, found: Correspondences) -> None:
        self.head, self.found = head, found
        self._mean, self._modes = linear_points(head, found.corners, found.weights)
        # Normals are compared at vertices: each takes the mean of the cells around it.
        rows, say = found.corners.ravel(), np.maximum(found.weights, 0.0).ravel()
        say = say * np.repeat(found.sure / found.sine**2, 3)
        count = len(head.mean)
        self._say = np.bincount(rows, say, count)
        pulled = np.stack([np.bincount(rows, say * np.repeat(found.normal[:, k], 3), count) for k in range(3)], 1)
        length = np.linalg.norm(pulled, axis=1)
        self.vertices: npt.NDArray[np.intp] = np.flatnonzero(length > 1e-6 * np.maximum(self._say, 1e-12))
        self._target = pulled[self.vertices] / length[self.vertices, None]
        skin = head.triangles[head.triangle_part == 0]
        around = skin[np.isin(skin, self.vertices).any(1)]
        self._near, local = np.unique(np.concatenate([around.ravel(), self.vertices]), return_inverse=True)
        self._around, self._chosen = np.split(local, [around.size])
        moves = linear_points(head, self._near[:, None], np.ones((len(self._near), 1)))[1]
        self._moves = moves.reshape(-1, moves.shape[-1])

    def points(self, state: State) -> PointTerm:
        """The correspondences, weighted by their certainty and by how well they agree with the state."""
        found = self.found
        points = linear(self._mean, self._modes, state.coefficients)
        sigma = state.scale * 1e-3 * found.sigma_mm
        residual = np.linalg.norm(project_points(state, points).uv - found.pixels, axis=1)
        weight = POINT_SHARE * found.sure * geman_mcclure(residual, GATE * np.maximum(sigma, 1e-9))
        return PointTerm(self._mean, self._modes, found.pixels, weight / np.maximum(sigma, 1e-9) ** 2)

    def normals(self, state: State, vertices: AnyFloat) -> NormalTerm:
        """The normals, linearised at a state with its (V, 3) vertices.

        They are compared after the rotation that brings all the read ones closest to the state's: what the reader
        gets wrong together is the direction to the camera, and that the points know better.
        """
        chosen = self.vertices
        normal = area_normals(vertices, self.head.triangles)[chosen].astype(np.float64)
        precision = self._say[chosen]
        turned = normal @ state.rotation.T
        target = self._target @ nearest_rotation((turned * precision[:, None]).T @ self._target).T
        apart = np.linalg.norm(turned - target, axis=1)
        typical = 1.0 / np.sqrt(np.maximum(precision, 1e-12))
        weight = NORMAL_SHARE * precision * geman_mcclure(apart, GATE * np.maximum(typical, 0.08))
        near = np.asarray(vertices[self._near], np.float64)
        by_place = normal_derivative(near, self._around.reshape(-1, 3), self._chosen)
        modes = (by_place @ self._moves).reshape(len(chosen), 3, -1)
        return NormalTerm(normal, modes, state.coefficients.copy(), target, weight)


def reading_agreement(found: Correspondences, state: State, vertices: AnyFloat) -> float:
    """Share of the cells within ``GATE`` standard deviations of a head (V, 3) at a state; 0 where there are none."""
    if not len(found.pixels):
        return 0.0
    sigma = state.scale * 1e-3 * found.sigma_mm
    points = at_barycentric(vertices, found.corners, found.weights)
    return float((np.linalg.norm(project_points(state, points).uv - found.pixels, axis=1) < GATE * sigma).mean())
