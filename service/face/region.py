"""Rotated square regions of a photo: cropping, and the maps between crop and photo coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from service.arrays import AnyFloat, Float64, UInt8


@dataclass(frozen=True)
class Region:
    """A square in photo pixels (pixel centres at +0.5), turned clockwise as seen on screen.

    Attributes:
        x, y: centre.
        side: edge length, > 0.
        angle: radians from the photo's x axis to the square's x axis, towards +y.
    """

    x: float
    y: float
    side: float
    angle: float = 0.0

    def matrix(self, size: int) -> Float64:
        """(2, 3) affine map from a (size, size) crop's pixel coordinates to photo coordinates."""
        step = self.side / size
        cos, sin = np.cos(self.angle) * step, np.sin(self.angle) * step
        half = size / 2
        return np.array([[cos, -sin, self.x - (cos - sin) * half], [sin, cos, self.y - (sin + cos) * half]], np.float64)

    def to_photo(self, points: AnyFloat, size: int) -> Float64:
        """(N, 2 or 3) crop pixels -> the same in photo pixels; a third column (depth) is only scaled."""
        points = np.asarray(points, np.float64)
        matrix = self.matrix(size)
        moved = points[:, :2] @ matrix[:, :2].T + matrix[:, 2]
        return np.concatenate([moved, points[:, 2:] * (self.side / size)], 1)

    def to_crop(self, points: AnyFloat, size: int) -> Float64:
        """(N, 2 or 3) photo pixels -> crop pixels; the inverse of ``to_photo``."""
        points = np.asarray(points, np.float64)
        matrix = self.matrix(size)
        moved = (points[:, :2] - matrix[:, 2]) @ np.linalg.inv(matrix[:, :2]).T
        return np.concatenate([moved, points[:, 2:] * (size / self.side)], 1)

    def cut(self, pixels: UInt8, size: int) -> UInt8:
        """(size, size, 3) uint8 crop of an (H, W, 3) photo, black outside, area-averaged where it is reduced."""
        height, width = pixels.shape[:2]
        shrink = max(1, round(self.side / size))  # OpenCV averages fast by integer factors
        reach = self.side * 0.7072 + 2 * shrink
        x0, x1 = (int(np.clip(self.x + s * reach, 0, width)) for s in (-1, 1))
        y0, y1 = (int(np.clip(self.y + s * reach, 0, height)) for s in (-1, 1))
        columns, rows = (x1 - x0) // shrink, (y1 - y0) // shrink
        if columns < 1 or rows < 1:
            return np.zeros((size, size, 3), np.uint8)
        patch = pixels[y0 : y0 + rows * shrink, x0 : x0 + columns * shrink]
        if shrink > 1:
            patch = np.asarray(cv2.resize(patch, (columns, rows), interpolation=cv2.INTER_AREA), np.uint8)
        matrix = self.matrix(size)
        linear = matrix[:, :2] / shrink
        shift = (matrix[:, 2] - [x0, y0]) / shrink + linear @ [0.5, 0.5] - 0.5  # cv2 puts pixel centres at integers
        warp = np.concatenate([linear, shift[:, None]], 1)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpAffine(np.ascontiguousarray(patch), warp, (size, size), flags=flags), np.uint8)


def level_square(points: Float64, angle: float, scale: float, below: float = 0.0) -> Region:
    """The square round points (N, 2), turned by an angle in radians, ``scale`` times as wide as their longer extent.

    Its middle lies ``below`` times its side below that of the points.
    """
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    level = points @ turn.T
    low, high = level.min(0), level.max(0)
    side = float((high - low).max()) * scale
    x, y = turn.T @ ((low + high) / 2 + [0.0, below * side])
    return Region(float(x), float(y), side, angle)


def roll(left_eye: Float64, right_eye: Float64, mouth: Float64) -> float:
    """Radians by which a face is turned clockwise in the photo; 0 where the three points coincide.

    The line between the eyes and the line from the eyes down to the mouth each give the roll. Their sum weights them by
    length, so that the second decides in a profile, where the eyes nearly coincide.
    """
    across = np.asarray(right_eye[:2], np.float64) - left_eye[:2]
    down = np.asarray(mouth[:2], np.float64) - (np.asarray(left_eye[:2]) + right_eye[:2]) / 2
    x, y = across[0] + down[1], across[1] - down[0]
    return float(np.arctan2(y, x)) if np.hypot(x, y) > 1e-6 else 0.0
