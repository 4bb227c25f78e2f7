"""The head model restricted to its landmarks: small dense bases for the landmark fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, AnyInt, Float32, Float64, Int32
from service.head.model import HeadModel


def at_barycentric(values: AnyFloat, corners: AnyInt, weights: AnyFloat) -> Float64:
    """(..., V, C) per-vertex values -> (..., L, C) at barycentric points: corners (L, 3) vertices, weights (L, 3)."""
    points = (values[..., corners, :].astype(np.float64) * weights.astype(np.float64)[..., None]).sum(-2)
    return np.ascontiguousarray(points)  # indexing in the middle leaves an order that makes every product copy


@dataclass(frozen=True)
class LandmarkBasis:
    """Landmark positions as a linear function of the coefficients.

    Attributes:
        mean: (L, 3) metres.
        modes: (K + E, L, 3) metres per unit coefficient, identity first.
        normals: (L, 3) unit normals on the average head.
        sigma: (L,) metres, expected scatter of the detector.
    """

    mean: Float64
    modes: Float64
    normals: Float64
    sigma: Float64

    def points(self, coefficients: Float64) -> Float64:
        """(K + E,) -> (L, 3) metres."""
        return np.asarray(self.mean + np.tensordot(coefficients, self.modes, 1))


class LandmarkModel:
    """Landmark bases of a head; the contour landmarks slide over the surface with the yaw."""

    def __init__(self, head: HeadModel, identity_components: int) -> None:
        self.identity_count = min(identity_components, len(head.identity))
        self.expression_count = len(head.expression)
        self.expression_names = head.expression_names
        self._contour = head.contour_landmarks
        self._yaw = np.asarray(head.contour_yaw_deg, np.float64)
        corners = head.triangles[head.landmark_triangle]
        self._fixed = self._gather(head, corners, head.landmark_barycentric)
        slide = head.triangles[head.contour_triangle.ravel()]
        self._slide = self._gather(head, slide, head.contour_barycentric.reshape(-1, 3))
        self._sigma = np.asarray(head.landmark_spread, np.float64)

    @property
    def shape_count(self) -> int:
        """Identity and expression coefficients together."""
        return self.identity_count + self.expression_count

    def _gather(self, head: HeadModel, corners: Int32, weights: Float32) -> list[Float64]:
        """[mean (L, 3), modes (K + E, L, 3), normals (L, 3)] at barycentric points of the mesh."""
        parts = (head.identity[: self.identity_count], head.expression)
        modes = np.concatenate([at_barycentric(part, corners, weights) for part in parts])
        p = head.mean[corners].astype(np.float64)
        normals = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        mean = at_barycentric(head.mean, corners, weights)
        return [mean, modes, np.where(length > 1e-15, normals / np.maximum(length, 1e-15), 0.0)]

    def at_yaw(self, yaw_deg: float) -> LandmarkBasis:
        """The basis for a head turned by ``yaw_deg``; contour landmarks are interpolated between calibrated yaws."""
        mean, modes, normals = (a.copy() for a in self._fixed)
        count = len(self._contour)
        if count and len(self._yaw):
            yaw = float(np.clip(yaw_deg, self._yaw[0], self._yaw[-1]))
            high = int(np.clip(np.searchsorted(self._yaw, yaw), 1, max(len(self._yaw) - 1, 1)))
            low = high - 1
            gap = self._yaw[high] - self._yaw[low] if high < len(self._yaw) else 0.0
            t = (yaw - self._yaw[low]) / gap if gap > 0 else 0.0
            high = min(high, len(self._yaw) - 1)
            for table, out in zip(self._slide, (mean, modes, normals), strict=True):
                a = table[..., low * count : (low + 1) * count, :]
                b = table[..., high * count : (high + 1) * count, :]
                out[..., self._contour, :] = (1 - t) * a + t * b
        length = np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        return LandmarkBasis(mean, modes, normals / length, self._sigma)
