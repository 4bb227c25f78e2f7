"""The pinhole camera that ties head space to photo pixels."""

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
