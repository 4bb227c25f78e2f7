"""Shapes beyond the head model's components: a Gaussian process over the head as further modes of the fit.

M. Luethi, T. Gerig, C. Jud, T. Vetter, "Gaussian Process Morphable Models" (PAMI 2018): a smooth random displacement
is a sum of modes of unit variance, so identity and free form are fitted as one linear model with one kind of prior. The
process is nearly symmetric; eyeballs, teeth and tongue move as one piece each, lids with their eyeball.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.arrays import Float32, Float64
from service.head.model import HeadModel

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
    for name in (name for name in RIGID if name in head.part_names):
        members = np.unique(head.triangles[head.triangle_part == head.part_names.index(name)])
        points[members] = 0.5 * (points[members].min(0) + points[members].max(0))
    socket = head.region("eye_socket") > 0.5
    # Lids and sockets go with their eyeball, whatever the field does there.
    for side in (side for side in ("eye_left", "eye_right") if side in head.part_names):
        members = np.unique(head.triangles[head.triangle_part == head.part_names.index(side)])
        centre = points[members[0]]
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


def extended(head: HeadModel, components: int, beyond: int, strength: float = 1.0) -> HeadModel:
    """The head with its first ``components`` of identity and ``beyond`` modes of the process after them.

    Args:
        head: any head model.
        components: as in ``FitSettings``; more than the head has means all.
        beyond: number of modes.
        strength: factor of the process's standard deviation.
    """
    further = np.float32(strength) * modes(head, beyond)
    return replace(head, identity=np.concatenate([head.identity[:components], further]))
