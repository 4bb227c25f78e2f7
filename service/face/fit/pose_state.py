"""The unknowns of the fit, their start from points by weak perspective, projection, and its Jacobian.

The unknowns are

    w (3) rotation step, tx, ty (2) metres, log scale, log distance, identity (K), expression (E)

with scale = focal / distance in pixels per metre. Focal length and distance are nearly degenerate for a face, whereas
scale and distance are nearly independent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import Float64
from service.geometry.camera import NEAREST_M, Camera, exp_rotation, nearest_rotation, skew

POSE = 7
"""Number of pose unknowns, which precede the shape coefficients."""


@dataclass(frozen=True)
class State:
    """A pose with shape coefficients.

    Attributes:
        rotation: (3, 3) head to camera.
        translation_xy: (2,) metres.
        log_scale: log of focal / distance in pixels per metre.
        log_distance: log of the distance of the head's origin in metres.
        coefficients: (K + E,) identity, then expression.
    """

    rotation: Float64
    translation_xy: Float64
    log_scale: float
    log_distance: float
    coefficients: Float64

    def stepped(self, step: Float64) -> State:
        """The state after a step of the unknowns: a rotation multiplied from the left, and a sum for the rest."""
        x = self.unknowns() + step
        rotation = nearest_rotation(exp_rotation(step[:3]) @ self.rotation)
        return State(rotation, x[3:5], float(x[5]), float(x[6]), x[POSE:])

    def unknowns(self) -> Float64:
        """(7 + K + E,) unknowns; the rotation is zero, since steps are relative to it."""
        pose = [np.zeros(3), self.translation_xy, [self.log_scale, self.log_distance]]
        return np.concatenate([*pose, self.coefficients])

    @property
    def scale(self) -> float:
        """Pixels per metre at the head's origin."""
        return float(np.exp(self.log_scale))

    @property
    def translation(self) -> Float64:
        """(3,) metres."""
        return np.array([*self.translation_xy, np.exp(self.log_distance)])

    @property
    def yaw_deg(self) -> float:
        """As :meth:`Camera.yaw_pitch_roll_deg` has it."""
        return float(np.degrees(np.arctan2(self.rotation[2, 0], -self.rotation[2, 2])))

    def camera(self, width: int, height: int) -> Camera:
        """The pinhole camera of this pose, principal point in the middle of the photo."""
        focal = float(np.exp(self.log_scale + self.log_distance))
        middle = np.array([width / 2, height / 2], np.float64)
        return Camera(width, height, focal, middle, self.rotation, self.translation)


@dataclass(frozen=True)
class Projection:
    """Points seen by a state.

    Attributes:
        turned: (N, 3) metres, rotated into camera axes, not translated.
        position: (N, 3) metres, camera space, depth clamped to NEAREST_M.
        uv: (N, 2) pixels relative to the principal point.
    """

    turned: Float64
    position: Float64
    uv: Float64


def project_points(state: State, points: Float64) -> Projection:
    """Project (N, 3) head-space metres."""
    turned = points @ state.rotation.T
    position = turned + state.translation
    position[:, 2] = np.maximum(position[:, 2], NEAREST_M)
    focal = np.exp(state.log_scale + state.log_distance)
    return Projection(turned, position, focal * position[:, :2] / position[:, 2:])


def motion(state: State, projection: Projection, modes: Float64) -> Float64:
    """(N, 3, 7 + M) derivative of camera-space positions by the unknowns, for (M, N, 3) shape modes."""
    count, shapes = len(projection.uv), len(modes)
    dy = np.zeros((count, 3, POSE + shapes))
    dy[:, :, :3] = -skew(projection.turned)
    dy[:, 0, 3] = dy[:, 1, 4] = 1.0
    dy[:, 2, 6] = np.exp(state.log_distance)
    dy[:, :, POSE:] = np.moveaxis(modes @ state.rotation.T, 0, 2)
    return dy


def pixel_jacobian(state: State, projection: Projection, dy: Float64) -> Float64:
    """(N, 2, 7 + M) derivative of uv by the unknowns, from :func:`motion`'s dy."""
    focal = np.exp(state.log_scale + state.log_distance)
    z = projection.position[:, 2, None, None]
    uv = projection.uv[:, :, None]
    jacobian = (focal * dy[:, :2] - uv * dy[:, 2:]) / z
    # The focal length itself moves with both logarithms.
    jacobian[:, :, 5] += projection.uv
    jacobian[:, :, 6] += projection.uv
    return np.asarray(jacobian)


@dataclass(frozen=True)
class WeakPose:
    """Scaled orthographic pose: pixel = scale * (rotation @ X)[:2] + offset.

    Attributes:
        rotation: (3, 3), camera axes x right, y down, z forward.
        scale: pixels per metre, > 0.
        offset: (2,) pixels.
    """

    rotation: Float64
    scale: float
    offset: Float64


def weak_pose(points: Float64, pixels: Float64, weights: Float64) -> WeakPose:
    """Least-squares scaled orthographic pose.

    Args:
        points: (N, 3) metres, head space.
        pixels: (N, 2).
        weights: (N,) >= 0, at least one positive.

    Returns:
        The pose; where the points do not determine it (fewer than four, or all on one line) an upright frontal one
        at the scale that the spread of the pixels suggests.
    """
    w = weights / max(float(weights.sum()), 1e-12)
    centre, middle = w @ points, w @ pixels
    x, u = points - centre, pixels - middle
    spread_x = float(np.sqrt((w[:, None] * x**2).sum()))
    spread_u = float(np.sqrt((w[:, None] * u**2).sum()))
    scale = max(spread_u, 1e-6) / max(spread_x, 1e-6)
    rotation = np.diag([1.0, -1.0, -1.0])
    moment = x.T @ (w[:, None] * x)
    if np.linalg.eigvalsh(moment)[0] > 1e-10:
        m = (np.linalg.solve(moment, x.T @ (w[:, None] * u))).T
        candidate_scale = float(np.linalg.norm(m, axis=1).mean())
        if candidate_scale > 1e-6:
            scale = candidate_scale
            unit = m / scale
            rotation = nearest_rotation(np.vstack([unit, np.cross(unit[0], unit[1])]))
    return WeakPose(rotation, scale, middle - scale * (rotation @ centre)[:2])
