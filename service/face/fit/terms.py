"""The terms of the fit's energy: their residuals and their parts of the normal equations.

A term returns half its sum of squares and adds J^T J and J^T r in place; ``energy`` and ``linearise`` sum over terms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from service.arrays import Float64
from service.face.fit.state import POSE, State, motion, pixel_jacobian, project


class Term(Protocol):
    """One addend of the energy."""

    def cost(self, state: State) -> float:
        """Half the weighted sum of squares."""

    def add(self, state: State, hessian: Float64, gradient: Float64) -> None:
        """Add J^T J and J^T r in place."""


@dataclass(frozen=True)
class PointTerm:
    """Reprojection error of points.

    Attributes:
        mean, modes: (N, 3) and (M, N, 3) metres, the points as a linear function of the coefficients.
        target: (N, 2) pixels relative to the principal point.
        precision: (N,) 1 / px^2, weights included.
        normal: (N, 2) unit vectors if only the distance along them counts (points on a contour), else None.
    """

    mean: Float64
    modes: Float64
    target: Float64
    precision: Float64
    normal: Float64 | None = None

    def _points(self, state: State) -> Float64:
        return np.asarray(self.mean + np.tensordot(state.coefficients, self.modes, 1))

    def _residual(self, uv: Float64) -> Float64:
        r = uv - self.target
        return r if self.normal is None else np.asarray((r * self.normal).sum(1, keepdims=True))

    def cost(self, state: State) -> float:
        """Half the weighted sum of squares."""
        r = self._residual(project(state, self._points(state)).uv)
        return 0.5 * float((self.precision[:, None] * r**2).sum())

    def add(self, state: State, hessian: Float64, gradient: Float64) -> None:
        """Add J^T J and J^T r in place."""
        projection = project(state, self._points(state))
        jacobian = pixel_jacobian(state, projection, motion(state, projection, self.modes))
        if self.normal is not None:
            jacobian = (jacobian * self.normal[:, :, None]).sum(1, keepdims=True)
        root = np.sqrt(self.precision)[:, None]
        j = (jacobian * root[:, :, None]).reshape(-1, len(gradient))
        hessian += j.T @ j
        gradient += j.T @ (self._residual(projection.uv) * root).ravel()


@dataclass(frozen=True)
class DepthTerm:
    """Error of the relative depth of points, up to a common offset.

    Attributes:
        mean, modes: as in PointTerm.
        depth: (N,) pixels at the head's scale, growing away from the camera.
        precision: (N,) 1 / px^2.
    """

    mean: Float64
    modes: Float64
    depth: Float64
    precision: Float64

    def _share(self) -> Float64:
        return np.asarray(self.precision / max(float(self.precision.sum()), 1e-12))

    def _residual(self, state: State) -> tuple[Float64, Float64]:
        turned = (self.mean + np.tensordot(state.coefficients, self.modes, 1)) @ state.rotation.T
        r = turned[:, 2] * state.scale - self.depth
        return turned, np.asarray(r - self._share() @ r)

    def cost(self, state: State) -> float:
        """Half the weighted sum of squares."""
        return 0.5 * float((self.precision * self._residual(state)[1] ** 2).sum())

    def add(self, state: State, hessian: Float64, gradient: Float64) -> None:
        """Add J^T J and J^T r in place."""
        turned, r = self._residual(state)
        jacobian = np.zeros((len(r), len(gradient)))
        jacobian[:, 0], jacobian[:, 1] = turned[:, 1], -turned[:, 0]
        jacobian[:, 5] = turned[:, 2]
        jacobian[:, POSE:] = (self.modes @ state.rotation[2]).T
        jacobian *= state.scale
        jacobian -= self._share() @ jacobian
        weighted = jacobian * self.precision[:, None]
        hessian += weighted.T @ jacobian
        gradient += weighted.T @ r


@dataclass(frozen=True)
class Prior:
    """Gaussian prior on log distance, log focal length and the shape coefficients.

    Attributes:
        log_distance, log_distance_sigma: metres.
        log_focal, log_focal_sigma: pixels.
        shape_precision: (K + E,) one over variance.
        shape_mean: (K + E,) coefficients that are most likely.
    """

    log_distance: float
    log_distance_sigma: float
    log_focal: float
    log_focal_sigma: float
    shape_precision: Float64
    shape_mean: Float64

    def _offsets(self, state: State) -> tuple[float, float]:
        a = (state.log_distance - self.log_distance) / self.log_distance_sigma
        b = (state.log_scale + state.log_distance - self.log_focal) / self.log_focal_sigma
        return a, b

    def cost(self, state: State) -> float:
        """Half the weighted sum of squares."""
        a, b = self._offsets(state)
        off = state.coefficients - self.shape_mean
        return 0.5 * float(a**2 + b**2 + (self.shape_precision * off**2).sum())

    def add(self, state: State, hessian: Float64, gradient: Float64) -> None:
        """Add J^T J and J^T r in place."""
        a, b = self._offsets(state)
        rows = np.zeros((2, len(gradient)))
        rows[0, 6] = 1 / self.log_distance_sigma
        rows[1, 5] = rows[1, 6] = 1 / self.log_focal_sigma
        hessian += rows.T @ rows
        gradient += rows.T @ np.array([a, b])
        index = np.arange(POSE, len(gradient))
        hessian[index, index] += self.shape_precision
        gradient[POSE:] += self.shape_precision * (state.coefficients - self.shape_mean)


def energy(terms: Sequence[Term], state: State) -> float:
    """The sum of the terms at a state."""
    return sum(term.cost(state) for term in terms)


def linearise(terms: Sequence[Term], state: State) -> tuple[Float64, Float64]:
    """J^T J (n, n) and J^T r (n,) of all terms at a state, by a step as :meth:`State.stepped` takes it."""
    n = POSE + len(state.coefficients)
    hessian, gradient = np.zeros((n, n)), np.zeros(n)
    for term in terms:
        term.add(state, hessian, gradient)
    return hessian, gradient
