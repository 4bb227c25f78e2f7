"""Stage B of the fit: the landmark fit refined by the silhouette and the shading of the face in the photo.

Each round finds edges along the occluding contour of the current head, estimates the light from the visible skin
(``shading.py``), and solves again with the landmark terms kept. On a turned head the silhouette of the far cheek, brow
and nose constrains the shape more than any landmark does. Each point of the model's occluding contour searches the
strongest edge along its normal in the photo (the classical active contour step; for face models: Bas et al., Fitting a
3D Morphable Model to Edges, ACCVW 2016).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import Bool, Float32, Float64, Int32, UInt8
from service.face.fit.basis import LandmarkModel
from service.face.fit.landmark_fit import LandmarkFit, bounds
from service.face.fit.shading import Softened, light_on_face, shading_term
from service.face.fit.solver import Damping, PointTerm, Term, minimise
from service.face.fit.state import POSE, State, project
from service.head.model import HeadModel
from service.robust import geman_mcclure

SAMPLES = 25
"""Samples along each search line, odd."""
SIGMA_M = 0.0008
"""Standard deviation of the distance from the contour to its edge, metres on the face."""
CONTRAST = 0.04
"""Edge strength (norm of the sRGB difference, components in [0, 1]) at which an edge gets half weight."""
_PROBE_M = 0.006
"""Distance outside a contour point at which other parts of the head are looked for, metres."""
_INDEPENDENT = 0.1
"""Weight of one contour point: neighbours see the same edge."""
_DEPTH_MAP = 256
"""Side of the coarse depth map in which silhouettes are told from inner folds, pixels."""


@dataclass(frozen=True)
class Outline:
    """Points of the occluding contour.

    Attributes:
        vertices: (N, 2) int, the two ends of each contour edge of the mesh.
        uv: (N, 2) pixels relative to the principal point, the middle of the edge.
        normal: (N, 2) unit, pointing out of the face.
    """

    vertices: Int32
    uv: Float64
    normal: Float64


class OutlineFinder:
    """Finds the occluding contour among the mesh edges of the face region."""

    def __init__(self, head: HeadModel) -> None:
        skin = np.flatnonzero(head.triangle_part == head.part_names.index("skin"))
        corners = head.triangles[skin]
        sides = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
        owner = np.tile(skin, 3)
        order = np.lexsort((sides[:, 1], sides[:, 0]))
        sides, owner = sides[order], owner[order]
        pair = np.flatnonzero((sides[1:] == sides[:-1]).all(1))
        self.edges = sides[pair]
        self.sides = np.stack([owner[pair], owner[pair + 1]], 1)
        face = head.region("face")[self.edges].min(1) > 0.5
        self.edges, self.sides = self.edges[face], self.sides[face]
        self.triangles = head.triangles

    def find(self, state: State, vertices: Float64) -> Outline:
        """The visible occluding contour of (V, 3) vertices in a pose."""
        projection = project(state, vertices)
        uv, position = projection.uv, projection.position
        p = position[self.triangles]
        normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        front = (normal * p.mean(1)).sum(1) < 0
        turning = front[self.sides[:, 0]] != front[self.sides[:, 1]]
        edges = self.edges[turning]
        near = np.where(front[self.sides[turning, 0]], self.sides[turning, 0], self.sides[turning, 1])
        middle = uv[edges].mean(1)
        along = uv[edges[:, 1]] - uv[edges[:, 0]]
        across = np.stack([-along[:, 1], along[:, 0]], 1)
        inside = uv[self.triangles[near]].mean(1) - middle
        across *= -np.sign((across * inside).sum(1, keepdims=True))
        length = np.linalg.norm(across, axis=1)
        keep = (length > 1e-6) & self._silhouette(state, uv, position, middle, across, length)
        return Outline(edges[keep], middle[keep], across[keep] / length[keep, None])

    def _silhouette(
        self, state: State, uv: Float64, position: Float64, middle: Float64, across: Float64, length: Float64
    ) -> Bool:
        """(N,) True where no part of the head lies just outside the contour point: a silhouette, not an inner fold."""
        from service.geometry.raster import rasterise

        if not len(middle):
            return np.zeros(0, bool)
        low, high = uv.min(0), uv.max(0)
        shrink = (_DEPTH_MAP - 1.0) / max(float((high - low).max()), 1e-6)
        small = (uv - low) * shrink + 1.0
        raster = rasterise(small, position[:, 2], self.triangles, _DEPTH_MAP + 2, _DEPTH_MAP + 2)
        probe = (middle + across / np.maximum(length, 1e-9)[:, None] * _PROBE_M * state.scale - low) * shrink + 1.0
        x, y = np.clip(probe.astype(int), 0, _DEPTH_MAP + 1).T
        return np.asarray(raster.triangle[y, x] < 0)


def outline_term(
    photo: Softened,
    middle: Float64,
    state: State,
    outline: Outline,
    mean: Float64,
    modes: Float64,
    reach_m: float,
) -> PointTerm | None:
    """Residuals between the contour and the edges of the photo, along the contour's normals.

    Args:
        photo: sRGB, blurred to about 1 mm on the face.
        middle: (2,) principal point, pixels.
        state: current pose.
        outline: N contour points at that pose.
        mean: (N, 3) metres, the contour points where all coefficients are zero.
        modes: (M, N, 3) metres, what each coefficient adds.
        reach_m: half length of the search lines, metres on the face.

    Returns:
        The term, or None where no contour point has an edge within reach.
    """
    import cv2

    if not len(outline.uv):
        return None
    offset = np.linspace(-1.0, 1.0, SAMPLES) * reach_m * state.scale
    where = photo.at(outline.uv[:, None] + offset[None, :, None] * outline.normal[:, None] + middle) - 0.5
    height, width = photo.image.shape[:2]
    x, y = np.moveaxis(where.astype(np.float32), -1, 0)
    lines = cv2.remap(photo.image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    outside: Bool = np.asarray(((where < 0) | (where > np.array([width - 1, height - 1]))).any(-1))
    step = np.linalg.norm(lines[:, 2:] - lines[:, :-2], axis=-1)
    step[outside[:, 1:-1]] = 0.0
    inner = offset[1:-1]
    score = step * np.exp(-0.5 * (inner / (0.5 * reach_m * state.scale)) ** 2)
    best = score.argmax(1)
    strength, shift = step[np.arange(len(best)), best], inner[best]
    contrast = strength**2 / (strength**2 + CONTRAST**2)
    sigma = SIGMA_M * state.scale
    weight = contrast * geman_mcclure(shift, 3.0 * sigma)
    if not (weight > 0.01).any():
        return None
    target = outline.uv + shift[:, None] * outline.normal
    return PointTerm(mean, modes, target, _INDEPENDENT * weight / max(sigma, 1e-9) ** 2, outline.normal)


REACH_M = (0.008, 0.004)
"""Half length of the contour's search lines in each round, metres on the face."""
BLUR_M = 0.0012
"""Standard deviation of the photo's blur before edges are searched, metres on the face."""
STEPS = 4
"""Solver steps of each round."""


class EdgeAndShadingFit:
    """Refines landmark fits of one head model."""

    def __init__(self, head: HeadModel, model: LandmarkModel) -> None:
        self.head, self.model = head, model
        self.outline = OutlineFinder(head)

    def refine(self, initial: LandmarkFit, pixels: UInt8, middle: Float64) -> tuple[State, Float64 | None]:
        """The refined state, and the light on the face there (:func:`light_on_face`).

        Where the photo has neither edges nor shading, the state is that of the landmark fit.

        Args:
            initial: the landmark fit.
            pixels: (H, W, 3) uint8 sRGB.
            middle: (2,) principal point in pixels.
        """
        state = initial.state
        soft = softened(pixels, middle, state, self._vertices(state))
        lower, upper = bounds(self.model)
        active = np.ones(POSE + self.model.shape_count, bool)
        for reach in REACH_M:
            terms = (*initial.terms, *self.terms(soft, middle, state, reach))
            state = minimise(state, terms, lower=lower, upper=upper, damping=Damping(), steps=STEPS, active=active)
        return state, light_on_face(self.head, soft, middle, state, self._vertices(state))

    def terms(self, soft: Softened, middle: Float64, state: State, reach: float) -> list[Term]:
        """The outline's and the shading's terms at a state, as far as the photo shows them.

        Args:
            soft: the photo blurred by ``BLUR_M``.
            middle: (2,) principal point in pixels.
            state: pose and shape.
            reach: half length of the search lines, metres on the face.
        """
        vertices = self._vertices(state)
        found: list[Term | None] = [
            self._outline(soft, middle, state, vertices, reach),
            shading_term(self.head, self.model, soft, middle, state, vertices),
        ]
        return [term for term in found if term is not None]

    def _vertices(self, state: State) -> Float64:
        identity, expression = np.split(state.coefficients, [self.model.identity_count])
        return self.head.shape(identity, expression).astype(np.float64)

    def _outline(self, photo: Softened, middle: Float64, state: State, vertices: Float64, reach: float) -> Term | None:
        outline = self.outline.find(state, vertices)
        ends = outline.vertices
        count = self.model.identity_count
        modes = np.concatenate([self.head.identity[:count, ends].mean(2), self.head.expression[:, ends].mean(2)])
        mean = self.head.mean[ends].mean(1)
        return outline_term(photo, middle, state, outline, mean.astype(np.float64), modes.astype(np.float64), reach)


def vertices_at(head: HeadModel, state: State) -> Float32:
    """(V, 3) metres of a head at a state with all coefficients of its identity."""
    return head.shape(*np.split(state.coefficients, [len(head.identity)]))


def softened(pixels: UInt8, middle: Float64, state: State, vertices: Float64) -> Softened:
    """A photo blurred by ``BLUR_M`` around the head whose vertices (V, 3) are those at a state."""
    return Softened.of(pixels, BLUR_M * state.scale, project(state, vertices).uv + middle)


def light_of(head: HeadModel, state: State, pixels: UInt8, middle: Float64) -> Float64 | None:
    """The light on the face at a state of ``head``, as :meth:`EdgeAndShadingFit.refine` gives it."""
    vertices = vertices_at(head, state).astype(np.float64)
    soft = softened(pixels, middle, state, vertices)
    return light_on_face(head, soft, middle, state, vertices)
