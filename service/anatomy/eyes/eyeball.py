"""Where the eyeballs are, and the angle of a point on one from its line of sight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.head.model import HeadModel
from service.head.regions import part_vertices

Array = npt.NDArray[np.float64]

SIDES = ("left", "right")
IRIS_RADIUS_M, PUPIL_RADIUS_M = 0.00585, 0.0019
"""Of adults: the iris is 11.7 mm wide in nearly everybody; the pupil as in a lit room."""
LEAST_RADIUS_M = 1e-4
"""Radius from which a part of a head counts as an eyeball."""


@dataclass(frozen=True)
class Eyeball:
    """A ball by the bounding box of an eye's vertices.

    Attributes:
        centre: (3,) float64 metres.
        radius: metres.
        low, high: (3,) float64 metres, the box.
    """

    centre: Array
    radius: float
    low: Array
    high: Array

    @classmethod
    def of(cls, vertices: npt.NDArray[np.floating]) -> Eyeball:
        """Of the (M, 3) vertices of one eye, M > 0, in metres."""
        low, high = (np.asarray(end, np.float64) for end in (vertices.min(0), vertices.max(0)))
        return cls((low + high) / 2, float((high - low).max()) / 2, low, high)

    @property
    def limbus_deg(self) -> float:
        """Angle of the iris's rim from the line of sight."""
        return self._angle(IRIS_RADIUS_M)

    @property
    def pupil_deg(self) -> float:
        """Angle of the pupil's rim from the line of sight."""
        return self._angle(PUPIL_RADIUS_M)

    def _angle(self, radius_m: float) -> float:
        return float(np.degrees(np.arcsin(min(radius_m / max(self.radius, 1e-6), 0.9))))

    def rays(self, points: npt.NDArray[np.floating]) -> Array:
        """(N, 3) unit directions from the centre to points (N, 3); zero at the centre itself."""
        ray = np.asarray(points, np.float64) - self.centre
        return np.asarray(ray / np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), 1e-9))


def eyeball(head: HeadModel, vertices: npt.NDArray[np.floating], side: str) -> Eyeball | None:
    """The left or right eyeball of a head with vertices (V, 3) in metres; None where it has none."""
    name = f"eye_{side}"
    own = part_vertices(head, name)
    if not len(own):
        return None
    ball = Eyeball.of(np.asarray(vertices, np.float64)[own])
    return ball if ball.radius > LEAST_RADIUS_M else None


def inter_ocular_m(head: HeadModel, vertices: npt.NDArray[np.floating]) -> float:
    """Distance of the eyeball centres in metres; 63 mm, people's mean, where the head has no two eyeballs."""
    centres = [
        np.asarray(vertices)[own].mean(0) for side in SIDES if len(own := part_vertices(head, f"eye_{side}"))
    ]
    return float(np.linalg.norm(centres[0] - centres[1])) if len(centres) == 2 else 0.063
