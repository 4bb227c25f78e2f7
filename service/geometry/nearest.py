"""Nearest points: OpenCV's k-d tree (FLANN), searched exactly.

scipy's takes 0.15 s to import and up to three times as long to answer; OpenCV is imported anyway.
"""

from __future__ import annotations

import numpy as np

from service.arrays import AnyFloat, Float32, Int64

LEAF = 10
"""Points in a leaf of the tree."""


class Nearest:
    """Answers which of some points are nearest to a place."""

    def __init__(self, points: AnyFloat) -> None:
        """Build the tree of points (N, D), N > 0; ValueError where there is none, or one is not finite."""
        import cv2

        self._points = np.array(points, np.float32, order="C")  # the tree keeps no copy
        if self._points.ndim != 2 or not self._points.size:
            raise ValueError(f"points must be (N, D), N and D at least 1, not {self._points.shape}")
        _finite(self._points)
        self._tree = cv2.flann.Index(self._points, {"algorithm": 4, "leaf_max_size": LEAF})  # one tree, exact

    def __call__(self, places: AnyFloat, count: int = 1) -> tuple[Float32, Int64]:
        """(M, k) distances to the points that are nearest to places (M, D), nearest first, and their (M, k) indices.

        k is ``count``, or the number of points where that is less. ValueError: a place is not finite.
        """
        count = min(count, len(self._points))
        asked = np.ascontiguousarray(places, np.float32)
        _finite(asked)
        if not len(asked):
            return np.zeros((0, count), np.float32), np.zeros((0, count), np.int32)
        index, squared = self._tree.knnSearch(asked, count, params={"checks": -1})
        return np.sqrt(squared), index.astype(np.int64)

    def one(self, places: AnyFloat) -> tuple[Float32, Int64]:
        """(M,) distance to the nearest point and (M,) its index; as calling with a count of 1."""
        apart, index = self(places)
        return apart[:, 0], index[:, 0]


def _finite(values: Float32) -> None:
    if not np.isfinite(values).all():
        raise ValueError("points and places must be finite")  # the tree would not end, or answer nonsense
