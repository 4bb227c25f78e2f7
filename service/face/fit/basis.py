"""The linear shape model of the fit: the head's components at its landmarks, and smooth modes beyond them.

M. Luethi, T. Gerig, C. Jud, T. Vetter, "Gaussian Process Morphable Models" (PAMI 2018): a smooth random displacement
is a sum of modes of unit variance, so identity and free form are fitted as one linear model with one kind of prior. The
process is nearly symmetric; eyeballs, teeth and tongue move as one piece each, lids with their eyeball.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.arrays import AnyFloat, AnyInt, Float32, Float64, Int32
from service.head.model import HeadModel
from service.head.regions import part_vertices


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


FIELDS = ((0.045, 0.9e-3), (0.022, 0.6e-3), (0.012, 0.3e-3))
"""Length scale and standard deviation, metres, of the processes that are summed."""
ASYMMETRIC = 0.12
"""Share of the variance that differs between left and right."""
RIGID = ("eye_left", "eye_right", "teeth_upper", "teeth_lower", "tongue")
"""Parts that move as one piece, where the head has them."""
HANDLES = 260
"""Points of half the face on which the process is decomposed."""


def places(head: HeadModel) -> Float64:
    """(V, 3) metres where the process is looked up for each vertex: itself, or the middle of its rigid part."""
    points = head.mean.astype(np.float64)
    for members in (part_vertices(head, name) for name in RIGID if name in head.part_names):
        points[members] = 0.5 * (points[members].min(0) + points[members].max(0))
    socket = head.region("eye_socket") > 0.5
    # Lids and sockets go with their eyeball, whatever the field does there.
    for eye in (part_vertices(head, name) for name in ("eye_left", "eye_right") if name in head.part_names):
        centre = points[eye[0]]
        near = np.exp(-((np.linalg.norm(head.mean - centre, axis=1) / 0.020) ** 4))[:, None]
        near[socket & (np.sign(head.mean[:, 0]) == np.sign(centre[0]))] = 1.0
        points = points + near * (centre - points)
    return np.asarray(points)


def kernel(one: Float64, other: Float64) -> Float64:
    """(N, M) square metres: covariance of the displacements of points (N, 3) and (M, 3) along one axis."""
    square = np.maximum((one**2).sum(1)[:, None] + (other**2).sum(1) - 2.0 * one @ other.T, 0.0)
    return np.asarray(sum(sigma**2 * np.exp(-square / (2.0 * length**2)) for length, sigma in FIELDS))


def modes(head: HeadModel, count: int) -> Float32:
    """(count, V, 3) float32 metres: the process's strongest modes on the head, each of unit variance."""
    points = places(head)
    flip = np.array([-1.0, 1.0, 1.0])
    face = np.flatnonzero((head.region("face") > 0.5) & (head.mean[:, 0] >= 0.0))
    handles = points[_spread(points, face, HANDLES)]
    fields: list[tuple[float, Float64, int, float]] = []
    for sign in (1.0, -1.0):
        direct = kernel(handles, handles) + sign * kernel(handles, handles * flip)
        values, vectors = np.linalg.eigh(direct)
        strong = values > 1e-6 * values[-1]
        on_head = kernel(points, handles) + sign * kernel(points, handles * flip)
        field = on_head @ (vectors[:, strong] / np.sqrt(values[strong]))
        for value, column in zip(values[strong], field.T, strict=True):
            for axis in range(3):
                # An even field is a symmetric displacement along y and z, an odd one along x.
                share = 1.0 - ASYMMETRIC if (axis == 0) == (sign < 0) else ASYMMETRIC
                fields.append((share * float(value), column, axis, np.sqrt(share)))
    fields.sort(key=lambda field: -field[0])
    result = np.zeros((min(count, len(fields)), len(points), 3), np.float32)
    for k, (_, column, axis, share) in enumerate(fields[: len(result)]):
        result[k, :, axis] = share * column
    return result


def _spread(points: Float64, among: np.ndarray, count: int) -> list[int]:
    """Indices of at most ``count`` points of ``among``, each as far from those before as can be."""
    chosen = [int(among[0])]
    distance = np.linalg.norm(points[among] - points[chosen[0]], axis=1)
    while len(chosen) < min(count, len(among)):
        chosen.append(int(among[int(distance.argmax())]))
        distance = np.minimum(distance, np.linalg.norm(points[among] - points[chosen[-1]], axis=1))
    return chosen


def extended(head: HeadModel, components: int, beyond: int) -> HeadModel:
    """The head with its first ``components`` of identity and ``beyond`` modes of the process after them.

    Args:
        head: any head model.
        components: as in ``FitSettings``; more than the head has means all.
        beyond: number of modes.
    """
    further = [modes(head, beyond)] if beyond else []
    return replace(head, identity=np.concatenate([head.identity[:components], *further]))
