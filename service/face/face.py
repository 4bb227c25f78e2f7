"""One face found in a photo."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from service.arrays import Float64

LANDMARK_COUNT = 468
"""MediaPipe face mesh topology."""


@dataclass(frozen=True)
class Face:
    """A detected face with its landmark mesh.

    Pixel coordinates have the centre of the top left pixel at (0.5, 0.5), x right, y down.

    Attributes:
        box: (4,) float64 x0, y0, x1, y1, detector box in photo pixels.
        score: detector probability in [0, 1].
        keypoints: (6, 2) float64 photo pixels: image-left eye, image-right eye, nose tip, mouth, image-left ear,
            image-right ear ("image-left" as seen when the face is upright).
        landmarks: (468, 3) float64: x, y in photo pixels, z in the same unit, growing away from the camera.
        presence: landmark network's face probability in [0, 1].
        warnings: stable codes found while locating the face.
    """

    box: Float64
    score: float
    keypoints: Float64
    landmarks: Float64
    presence: float
    warnings: tuple[str, ...] = field(default=())

    @property
    def area(self) -> float:
        """Area of the box in square pixels."""
        return float(np.prod(np.maximum(self.box[2:] - self.box[:2], 0)))
