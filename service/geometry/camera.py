"""The pinhole camera that ties head space to photo pixels, and rotations by their exponential map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, Float64

NEAREST_M = 0.05
"""Points closer than this (metres along the axis) are clamped before the division by depth."""


@dataclass(frozen=True)
class Camera:
    """Pinhole camera without distortion.

    A head point X (metres, +Y up, +Z out of the face) has camera coordinates ``rotation @ X + translation`` with
    x right, y down, z forward, and lands on ``focal_px * (x / z, y / z) + principal_point``. Pixel centres lie at
    +0.5.

    Attributes:
        width, height: photo size in pixels.
        focal_px: focal length in pixels, > 0.
        principal_point: (2,) float64 pixels.
        rotation: (3, 3) float64, det +1.
        translation: (3,) float64 metres.
    """

    width: int
    height: int
    focal_px: float
    principal_point: Float64
    rotation: Float64
    translation: Float64

    def to_camera(self, points: AnyFloat) -> Float64:
        """(N, 3) head space metres -> (N, 3) camera space metres."""
        return np.asarray(points, np.float64) @ self.rotation.T + self.translation

    def project(self, points: AnyFloat) -> Float64:
        """(N, 3) head space metres -> (N, 2) photo pixels; depth below NEAREST_M is clamped to it."""
        camera_points = self.to_camera(points)
        depth = np.maximum(camera_points[:, 2:], NEAREST_M)
        return self.focal_px * camera_points[:, :2] / depth + self.principal_point

    @property
    def centre(self) -> Float64:
        """(3,) camera position in head space, metres."""
        return -self.rotation.T @ self.translation

    def yaw_pitch_roll_deg(self) -> tuple[float, float, float]:
        """Head angles in degrees: yaw > 0 turned towards the image right, pitch > 0 looking up, roll > 0 clockwise.

        Yaw and pitch are those of the direction from which the camera sees the head, so turning the photo in its plane
        changes the roll alone.
        """
        r = self.rotation
        yaw = np.degrees(np.arctan2(r[2, 0], -r[2, 2]))
        pitch = np.degrees(np.arcsin(np.clip(r[2, 1], -1.0, 1.0)))
        roll = np.degrees(np.arctan2(r[0, 1], -r[1, 1]))
        return float(yaw), float(pitch), float(roll)


def skew(w: Float64) -> Float64:
    """(..., 3) vectors -> (..., 3, 3) matrices with ``skew(w) @ v == cross(w, v)``."""
    zero = np.zeros_like(w[..., 0])
    x, y, z = w[..., 0], w[..., 1], w[..., 2]
    rows = [np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)]
    return np.stack(rows, -2)


def exp_rotation(w: Float64) -> Float64:
    """(3,) rotation vector in radians -> (3, 3) rotation (Rodrigues; Taylor series near zero)."""
    angle = float(np.linalg.norm(w))
    k = skew(np.asarray(w, np.float64))
    # Radians below which sin(a)/a and (1-cos(a))/a^2 are taken from their Taylor series.
    if angle < 1e-4:
        a, b = 1.0 - angle**2 / 6.0, 0.5 - angle**2 / 24.0
    else:
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2
    return np.asarray(np.eye(3) + a * k + b * k @ k)


def nearest_rotation(matrix: Float64) -> Float64:
    """The rotation (det +1) nearest to a (3, 3) matrix in the Frobenius norm; the identity for a zero matrix."""
    u, _, vt = np.linalg.svd(matrix)
    d = np.sign(np.linalg.det(u @ vt))
    return np.asarray(u @ np.diag([1.0, 1.0, d if d else 1.0]) @ vt)


def ahead(ray: Float64) -> Float64:
    """(3, 3) smallest rotation that takes a ray (3,) with z > 0 to the z axis; the rows are orthonormal axes.

    ValueError: the ray does not lead forward.
    """
    length = float(np.linalg.norm(ray))
    if not np.isfinite(length) or not ray[2] > 0:
        raise ValueError(f"the ray {ray.tolist()} does not lead forward: its third component must be above 0")
    x, y, z = ray / length
    # Rodrigues' formula about (y, -x, 0); 1 / (1 + z) is finite for z > 0.
    k = 1.0 / (1.0 + z)
    return np.array([[1.0 - k * x * x, -k * x * y, -x], [-k * x * y, 1.0 - k * y * y, -y], [x, y, z]])
