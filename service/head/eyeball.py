"""Centre and size of the eyeballs, and the angular radii of iris and pupil."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, Float64
from service.head.model import HeadModel
from service.head.regions import part_vertices

SIDES = ("left", "right")
IRIS_RADIUS_M, PUPIL_RADIUS_M = 0.00585, 0.0019
"""Of adults: the iris is 11.7 mm wide in nearly everybody; the pupil is that of a lit room."""

LEAST_RADIUS_M = 1e-4
"""Radius in metres from which a part of a head counts as an eyeball."""


@dataclass(frozen=True)
class Eyeball:
    """A sphere from the bounding box of an eye's vertices.

    Attributes:
        centre: (3,) float64 metres.
        radius: metres.
        low, high: (3,) float64 metres, corners of the bounding box.
    """

    centre: Float64
    radius: float
    low: Float64
    high: Float64

    @classmethod
    def of(cls, vertices: AnyFloat) -> Eyeball:
        """From the (M, 3) vertices of one eye, M > 0, in metres."""
        low, high = (np.asarray(end, np.float64) for end in (vertices.min(0), vertices.max(0)))
        return cls((low + high) / 2, float((high - low).max()) / 2, low, high)

    @property
    def limbus_deg(self) -> float:
        """Degrees between the line of sight and the limbus, the iris's rim."""
        return self._angle(IRIS_RADIUS_M)

    @property
    def pupil_deg(self) -> float:
        """Degrees between the line of sight and the pupil's rim."""
        return self._angle(PUPIL_RADIUS_M)

    def _angle(self, radius_m: float) -> float:
        return float(np.degrees(np.arcsin(min(radius_m / max(self.radius, 1e-6), 0.9))))

    def rays(self, points: AnyFloat) -> Float64:
        """(N, 3) unit directions from the centre to points (N, 3); zero at the centre itself."""
        ray = np.asarray(points, np.float64) - self.centre
        return np.asarray(ray / np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), 1e-9))


def eyeball(head: HeadModel, vertices: AnyFloat, side: str) -> Eyeball | None:
    """The left or right eyeball of a head with vertices (V, 3) in metres; None where it has none."""
    name = f"eye_{side}"
    indices = part_vertices(head, name)
    if not len(indices):
        return None
    ball = Eyeball.of(np.asarray(vertices, np.float64)[indices])
    return ball if ball.radius > LEAST_RADIUS_M else None


def inter_ocular_m(head: HeadModel, vertices: AnyFloat) -> float:
    """Distance of the eyeball centres in metres; 63 mm, the mean of adults, for a head without two eyeballs."""
    centres = [np.asarray(vertices)[eye].mean(0) for side in SIDES if len(eye := part_vertices(head, f"eye_{side}"))]
    return float(np.linalg.norm(centres[0] - centres[1])) if len(centres) == 2 else 0.063


def pole(head: HeadModel, side: str) -> int:
    """The vertex in the middle of the left or right cornea, which looks ahead at rest."""
    eye = part_vertices(head, f"eye_{side}")
    return int(eye[np.argmax(head.mean[eye, 2])])
