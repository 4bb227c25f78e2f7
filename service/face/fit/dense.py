"""Stage C of the fit: the landmark fit refined by what the reader sees at every pixel.

Dense landmarks with a Gaussian uncertainty each (Wood et al., "3D face reconstruction with dense landmarks", ECCV 2022)
and per-pixel chart coordinates and normals (Giebenhain et al., "Pixel3DMM", 2025), in the same normal equations as the
landmarks. Pose, identity, expression and free form are solved together, on landmarks, correspondences, normals, outline
and shading; every round weighs them anew at the state that the round before has found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from service.arrays import AnyFloat, Bool, Float64, Int32, UInt8
from service.face.fit.basis import LandmarkModel, at_barycentric, extended
from service.face.fit.edges_and_shading import REACH_M, EdgeAndShadingFit, softened, vertices_at
from service.face.fit.landmark_fit import LandmarkFit, bounds, weigh
from service.face.fit.settings import FitSettings
from service.face.fit.shading import normal_derivative
from service.face.fit.solver import Damping, PointTerm, Prior, Term, minimise
from service.face.fit.state import POSE, State, project
from service.face.reading.parts import READ
from service.face.reading.reader import CELLS, Reading
from service.geometry.camera import nearest_rotation, skew
from service.geometry.chart import Chart
from service.geometry.normals import area_normals
from service.head.model import HeadModel
from service.robust import geman_mcclure

LOOKUP = (768, 512)
"""Texels in which the triangle of a chart coordinate is looked up; the place in it is exact."""
LEAST_SHARE = 0.6
"""Least probability of the parts whose chart coordinates are learnt, from which a cell is used."""
POINT_SHARE, NORMAL_SHARE = 0.04, 0.01
"""Weight of one cell beside its stated uncertainty: errors of neighbours are alike."""
FLOOR_MM, FLOOR_SINE = 0.7, 0.05
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
    usable = (share > LEAST_SHARE) & np.isfinite(uv).all(-1) & ((uv > 0) & (uv < 1)).all(-1)
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
    width, height = LOOKUP
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
class NormalTerm:
    """Difference between the head's normals and the read ones; exact in the rotation, linearised in the shape.

    Attributes:
        normal: (N, 3) unit, head space, at the start; slope: (N, 3, M) its derivative by the coefficients.
        start: (M,) coefficients of the linearisation.
        target: (N, 3) unit, camera space.
        precision: (N,) >= 0.
    """

    normal: Float64
    slope: Float64
    start: Float64
    target: Float64
    precision: Float64

    def _normals(self, state: State) -> Float64:
        return np.asarray((self.normal + self.slope @ (state.coefficients - self.start)) @ state.rotation.T)

    def cost(self, state: State) -> float:
        """Half the weighted sum of squares."""
        return 0.5 * float((self.precision[:, None] * (self._normals(state) - self.target) ** 2).sum())

    def add(self, state: State, hessian: Float64, gradient: Float64) -> None:
        """Add J^T J and J^T r in place."""
        turned = self._normals(state)
        jacobian = np.zeros((len(turned), 3, len(gradient)))
        jacobian[:, :, :3] = -skew(turned)
        jacobian[:, :, POSE:] = state.rotation @ self.slope
        root = np.sqrt(self.precision)[:, None]
        j = (jacobian * root[:, :, None]).reshape(-1, len(gradient))
        hessian += j.T @ j
        gradient += j.T @ ((turned - self.target) * root).ravel()


class DenseTerms:
    """The terms of one reading for one head model with some of its components.

    Args:
        head: whose identity is fitted whole (``service.face.fit.basis.extended`` cuts and extends it).
        found: what the reader found.
    """

    def __init__(self, head: HeadModel, found: Correspondences) -> None:
        self.head, self.found = head, found
        modes = np.concatenate([at_barycentric(part, found.corners, found.weights) for part in _bases(head)])
        self._mean, self._modes = at_barycentric(head.mean, found.corners, found.weights), modes
        # Normals are compared at vertices: each takes the mean of the cells around it.
        rows, say = found.corners.ravel(), np.maximum(found.weights, 0.0).ravel()
        say = say * np.repeat(found.sure / found.sine**2, 3)
        count = len(head.mean)
        self._say = np.bincount(rows, say, count)
        pulled = np.stack([np.bincount(rows, say * np.repeat(found.normal[:, k], 3), count) for k in range(3)], 1)
        length = np.linalg.norm(pulled, axis=1)
        self.vertices: npt.NDArray[np.intp] = np.flatnonzero(length > 1e-6 * np.maximum(self._say, 1e-12))
        self._target = pulled[self.vertices] / length[self.vertices, None]

    def points(self, state: State) -> PointTerm:
        """The correspondences, weighted by their certainty and by how well they agree with the state."""
        found = self.found
        points = self._mean + np.tensordot(state.coefficients, self._modes, 1)
        sigma = state.scale * 1e-3 * found.sigma_mm
        residual = np.linalg.norm(project(state, points).uv - found.pixels, axis=1)
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
        skin = self.head.triangles[self.head.triangle_part == 0]
        shape = np.asarray(vertices, np.float64)
        slope = np.concatenate([normal_derivative(shape, basis, skin, chosen) for basis in _bases(self.head)], 2)
        return NormalTerm(normal, slope, state.coefficients.copy(), target, weight)


def _bases(head: HeadModel) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    return head.identity, head.expression


def seen_share(found: Correspondences, state: State, terms: DenseTerms) -> float:
    """Share of the cells that agree with a state to within ``GATE`` standard deviations; 0 where there are none."""
    if not len(found.pixels):
        return 0.0
    sigma = state.scale * 1e-3 * found.sigma_mm
    points = terms._mean + np.tensordot(state.coefficients, terms._modes, 1)
    agrees: Bool = np.asarray(np.linalg.norm(project(state, points).uv - found.pixels, axis=1) < GATE * sigma)
    return float(agrees.mean())


STEPS = 4
"""Solver steps of each round."""
FEWEST_CELLS = 150
"""Fewest cells with a place on the head from which a reading is followed."""
LEAST_AGREEMENT = 0.3
"""Least share of them that has to agree with the landmark fit: below it, reader and landmarks see different faces."""


class DenseFit:
    """Refines landmark fits of one head model by readings.

    Args:
        head: the head model.
        settings: identity components, number of the modes beyond them, whether normals are followed.
    """

    def __init__(self, head: HeadModel, settings: FitSettings) -> None:
        self.plain, self.normals = head, settings.normals
        self.components = min(settings.identity_components, len(head.identity))
        self.head = extended(head, self.components, settings.beyond if settings.refine == "full" else 0)
        self.beyond = len(self.head.identity) - self.components
        self.model = LandmarkModel(self.head, len(self.head.identity))
        self.edges = EdgeAndShadingFit(self.head, self.model)

    def refine(
        self, initial: LandmarkFit, face: Float64, photo: UInt8, reading: Reading, prior: Prior
    ) -> LandmarkFit | None:
        """The refined fit, its coefficients those of the extended head; None where the reading is not understood.

        Args:
            initial: the landmark fit of the plain head.
            face: (L, 3) landmarks, photo pixels.
            photo: (H, W, 3) uint8 sRGB; the principal point is its middle.
            reading: of the same photo.
            prior: of the plain head's fit.
        """
        middle = np.array([photo.shape[1] / 2, photo.shape[0] / 2])
        state = self._widened(initial.state)
        found = correspondences(self.head, reading, state, middle)
        if len(found.pixels) < FEWEST_CELLS:
            return None
        dense = DenseTerms(self.head, found)
        if seen_share(found, state, dense) < LEAST_AGREEMENT:
            return None
        prior = self._prior(prior)
        good: Bool = np.asarray(np.isfinite(face).all(1))
        known = np.where(good[:, None], face, 0.0)
        trust = good.astype(np.float64)
        lower, upper = bounds(self.model)
        soft = softened(photo, middle, state, vertices_at(self.head, state).astype(np.float64))
        for reach in REACH_M:
            vertices = vertices_at(self.head, state)
            basis = self.model.at_yaw(state.yaw_deg)
            near = weigh(state, basis, known[:, :2] - middle, known[:, 2], trust, 2.5)[1]
            read = (dense.points(state), *((dense.normals(state, vertices),) if self.normals else ()))
            terms: tuple[Term, ...] = (*near, prior, *read, *self.edges.terms(soft, middle, state, reach))
            active = np.ones(POSE + self.model.shape_count, bool)
            state = minimise(state, terms, lower=lower, upper=upper, damping=Damping(), steps=STEPS, active=active)
        basis = self.model.at_yaw(state.yaw_deg)
        weight, near = weigh(state, basis, known[:, :2] - middle, known[:, 2], trust, 2.5)
        return LandmarkFit(state, basis, weight, (*near, prior))

    def _widened(self, state: State) -> State:
        identity, expression = np.split(state.coefficients, [self.components])
        return replace(state, coefficients=np.concatenate([identity, np.zeros(self.beyond), expression]))

    def _prior(self, prior: Prior) -> Prior:
        def widened(values: Float64, beyond: float) -> Float64:
            identity, expression = np.split(values, [self.components])
            return np.concatenate([identity, np.full(self.beyond, beyond), expression])

        return replace(
            prior, shape_precision=widened(prior.shape_precision, 1.0), shape_mean=widened(prior.shape_mean, 0.0)
        )
