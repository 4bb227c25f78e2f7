"""Fit our head to another surface in three dimensions: similarity and identity, point to plane.

Used to measure what heads the model can hold and to carry landmarks and regions over to another topology.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.geometry.mesh import area_normals
from service.head.model import HeadModel

Float = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Cloud:
    """points (N, 3) metres and unit normals (N, 3) of a face, origin between the eyes, +Z forward."""

    points: Float
    normals: Float


@dataclass(frozen=True)
class Registration:
    """A fitted head.

    Attributes:
        vertices: (V, 3) metres in the cloud's frame.
        identity: (k,) standard deviations.
        distance: (N,) metres from each point of the cloud to the fitted surface.
    """

    vertices: Float
    identity: Float
    distance: Float


def hidden_behind(vertices: Float, candidates: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """(V,) candidates more than 6 mm behind the foremost one within a 2 mm cell (mouth lining, sockets, nostrils).

    Cells are looked at with their eight neighbours, so that a coarse mesh hides what lies behind it too.
    """
    here = np.flatnonzero(candidates)
    cell = np.round(vertices[here, :2] / 0.002).astype(int)
    key = cell[:, 0] * 100003 + cell[:, 1]
    cells, which = np.unique(key, return_inverse=True)
    front = np.full(len(cells), -np.inf)
    np.maximum.at(front, which, vertices[here, 2])
    nearest = front.copy()
    for step in [dx * 100003 + dy for dx in (-1, 0, 1) for dy in (-1, 0, 1)]:
        at = np.minimum(np.searchsorted(cells, cells + step), len(cells) - 1)
        nearest = np.where(cells[at] == cells + step, np.maximum(nearest, front[at]), nearest)
    behind = np.zeros(len(vertices), bool)
    behind[here] = vertices[here, 2] < nearest[which] - 0.006
    return behind


class Fitter:
    """Fits the identity of a head model to clouds."""

    def __init__(self, model: HeadModel) -> None:
        """Sample the model's front skin: vertices, edge middles and centroids as barycentric points."""
        skin = model.triangles[model.triangle_part == 0]
        inner = (
            model.region("mouth_inner") + model.region("eye_socket") if "mouth_inner" in model.region_names else None
        )
        if inner is not None:
            skin = skin[(inner[skin] < 0.5).all(1)]
        self.triangles = skin
        self.model = model
        weights = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5], [1 / 3] * 3])
        self.corner = np.repeat(skin, len(weights), axis=0)
        self.weight = np.tile(weights, (len(skin), 1))

    def fit(self, cloud: Cloud, components: int, bound: float, iterations: int = 14) -> Registration:
        """Fit ``components`` coefficients, each within +-``bound`` standard deviations."""
        from scipy.optimize import lsq_linear
        from scipy.spatial import cKDTree

        basis = self.model.identity[:components].astype(float)
        mean = self.model.mean.astype(float)
        a, scale, rotation, shift = np.zeros(components), 1.0, np.eye(3), np.zeros(3)
        for step in range(iterations):
            vertices = (mean + np.tensordot(a, basis, 1)) @ rotation.T * scale + shift
            normals = area_normals(vertices, self.triangles)
            points = (vertices[self.corner] * self.weight[..., None]).sum(1)
            direction = normals[self.corner[:, 0]]
            distance, nearest = cKDTree(points).query(cloud.points)
            n = cloud.normals
            good = (direction[nearest] * n).sum(1) > 0.5
            good &= distance < max(0.004, np.percentile(distance, 97))
            nearest, n, target = nearest[good], n[good], cloud.points[good]
            p = points[nearest]
            residual = ((target - p) * n).sum(1)
            moved = np.einsum("kvc,dc->kvd", basis, rotation * scale)
            columns = np.einsum(
                "nkd,nd->nk", np.einsum("kncd,nc->nkd", moved[:, self.corner[nearest]], self.weight[nearest]), n
            )
            rigid = np.c_[np.cross(p, n), n, ((p - shift) * n).sum(1)]
            jacobian = np.c_[columns, rigid] / 1e-3
            gram = jacobian.T @ jacobian + np.diag(np.r_[np.full(components, 0.02 * len(p)), np.full(7, 1e-9)])
            right = jacobian.T @ (residual / 1e-3) - np.r_[0.02 * len(p) * a, np.zeros(7)]
            factor = np.linalg.cholesky(gram + 1e-9 * np.eye(len(gram)) * np.trace(gram) / len(gram))
            limit = bound if step > 2 else min(bound, 1.0)
            low = np.r_[np.minimum(-limit - a, -1e-9), np.full(7, -np.inf)]
            high = np.r_[np.maximum(limit - a, 1e-9), np.full(7, np.inf)]
            d = lsq_linear(factor.T, np.linalg.solve(factor, right), (low, high)).x
            a = a + d[:components]
            turn, move, grow = d[components : components + 3], d[components + 3 : components + 6], d[-1]
            spin = _rotation(turn)
            shift = spin @ shift + move
            rotation, scale = spin @ rotation, scale * (1 + grow)
        vertices = (mean + np.tensordot(a, basis, 1)) @ rotation.T * scale + shift
        return Registration(vertices, a, surface_distance(cloud.points, vertices, self.triangles))


def _rotation(turn: Float) -> Float:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(turn).as_matrix())


def surface_distance(points: Float, vertices: Float, triangles: npt.NDArray[np.integer], candidates: int = 16) -> Float:
    """(N,) exact distance to the nearest of each point's closest triangles (by centroid)."""
    from scipy.spatial import cKDTree

    from models.head.nearest import nearest_on_triangles

    corner = vertices[triangles]
    near = cKDTree(corner.mean(1)).query(points, k=candidates)[1]
    chosen, many = corner[near.ravel()], np.repeat(points, candidates, axis=0)
    foot = np.einsum("nk,nkc->nc", nearest_on_triangles(chosen, many), chosen)
    gap = np.linalg.norm(foot - many, axis=1)
    return np.asarray(gap.reshape(len(points), candidates).min(1))
