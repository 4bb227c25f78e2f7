"""The photo blurred for the fit, with no more pixels than the blur needs: 48 megapixels would take gigabytes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, Float32, Float64, UInt8

MOST_BLUR = 50.0
"""Largest standard deviation, photo pixels."""
PIXELS_IN_BLUR = 4.0
"""A standard deviation keeps at least so many pixels."""


@dataclass(frozen=True)
class Softened:
    """A blurred photo.

    Attributes:
        image: (h, w, 3) float32 sRGB in [0, 1].
        step: side of one of its pixels in pixels of the photo, >= 1, across and down.
    """

    image: Float32
    step: Float64

    @classmethod
    def of(cls, pixels: UInt8, sigma_px: float) -> Softened:
        """SRGB of a photo (H, W, 3) under a Gaussian of ``sigma_px`` photo pixels; none below a third of a pixel."""
        import cv2

        sigma = min(sigma_px, MOST_BLUR)
        times = max(int(sigma / PIXELS_IN_BLUR), 1)
        height, width = pixels.shape[:2]
        size = (max(width // times, 1), max(height // times, 1))
        small = pixels if times == 1 else cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
        image: Float32 = np.asarray(small, np.float32) / np.float32(255)
        if sigma >= 1 / 3:
            image = np.asarray(cv2.GaussianBlur(image, (0, 0), sigma / times), np.float32)
        return cls(image, np.array([width, height], np.float64) / image.shape[1::-1])

    def at(self, position: AnyFloat) -> Float64:
        """(..., 2) positions in its pixels of photo pixels (..., 2), centres at +0.5 in both."""
        return np.asarray(position, np.float64) / self.step
