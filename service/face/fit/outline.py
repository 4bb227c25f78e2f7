"""Occluding contour of the head, matched to edges of the photo.

On a turned head the silhouette of the far cheek, brow and nose constrains the shape more than any landmark does. Each
point of the model's occluding contour searches the strongest edge along its normal in the photo (the classical active
contour step; for face models: Bas et al., Fitting a 3D Morphable Model to Edges, ACCVW 2016).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import Bool, Float64, Int32
from service.face.fit.face_light import Softened
from service.face.fit.pose_state import State, project_points
from service.face.fit.solver import PointTerm
from service.head.model import HeadModel
from service.robust import geman_mcclure

SAMPLES = 25
"""Samples along each search line, odd."""
SIGMA_M = 0.0008
"""Standard deviation of the distance from the contour to its edge, metres on the face."""
CONTRAST = 0.04
"""Edge strength (norm of the sRGB difference, components in [0, 1]) at which an edge gets half weight."""
_INDEPENDENT = 0.1
"""Weight of one contour point: neighbours see the same edge."""


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
    """Finds the occluding contour among the mesh edges of the face region, and its edges in the photo."""

    def __init__(self, head: HeadModel) -> None:
        self.head = head
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
        """The occluding contour of (V, 3) vertices in a pose, folds within the face's outline included."""
        projection = project_points(state, vertices)
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
        keep = length > 1e-6
        return Outline(edges[keep], middle[keep], across[keep] / length[keep, None])

    def term(
        self, photo: Softened, middle: Float64, state: State, vertices: Float64, reach_m: float
    ) -> PointTerm | None:
        """Residuals between the contour and the edges of the photo, along the contour's normals.

        Args:
            photo: sRGB, blurred to about 1 mm on the face.
            middle: (2,) principal point, pixels.
            state: current pose and coefficients of all of the head's identity and expression.
            vertices: (V, 3) metres at that state.
            reach_m: half length of the search lines, metres on the face.

        Returns:
            The term, or None where no contour point has an edge within reach.
        """
        import cv2

        outline = self.find(state, vertices)
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
        ends, head = outline.vertices, self.head
        modes = np.concatenate([head.identity[:, ends].mean(2), head.expression[:, ends].mean(2)]).astype(np.float64)
        mean = head.mean[ends].mean(1).astype(np.float64)
        target = outline.uv + shift[:, None] * outline.normal
        return PointTerm(mean, modes, target, _INDEPENDENT * weight / max(sigma, 1e-9) ** 2, outline.normal)
