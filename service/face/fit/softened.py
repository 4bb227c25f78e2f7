"""The photo blurred for the fit, with no more pixels than the blur needs: 48 megapixels would take gigabytes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, Float32, Float64, UInt8

MOST_BLUR = 50.0
"""Largest standard deviation, photo pixels."""
PIXELS_IN_BLUR = 4.0
"""A standard deviation keeps at least so many pixels."""
AROUND = 0.3
"""Border around the head over its size: as far as a fit may move it, and more than the edges' search lines reach."""


@dataclass(frozen=True)
class Softened:
    """A blurred photo.

    Attributes:
        image: (h, w, 3) float32 sRGB in [0, 1].
        step: side of one of its pixels in pixels of the photo, >= 1, across and down.
        corner: (2,) x and y in the photo of the rectangle that it shows.
    """

    image: Float32
    step: Float64
    corner: Float64

    @classmethod
    def of(cls, pixels: UInt8, sigma_px: float, head: Float64) -> Softened:
        """SRGB of a photo (H, W, 3) under a Gaussian of ``sigma_px`` photo pixels; none below a third of a pixel.

        Args:
            pixels: the photo.
            sigma_px: standard deviation.
            head: (N, 2) photo pixels of the head; what lies further than ``AROUND`` from them is left out.
        """
        import cv2

        sigma = min(sigma_px, MOST_BLUR)
        times = max(int(sigma / PIXELS_IN_BLUR), 1)
        border = AROUND * float(np.ptp(head, axis=0).max()) + 4 * sigma
        whole = np.array(pixels.shape[1::-1])
        low = np.clip((head.min(0) - border) // times * times, 0, whole - 1).astype(int)
        high = np.clip(head.max(0) + border, low + 1, whole).astype(int)
        pixels = pixels[low[1] : high[1], low[0] : high[0]]
        height, width = pixels.shape[:2]
        size = (max(width // times, 1), max(height // times, 1))
        small = pixels if times == 1 else cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
        image: Float32 = np.asarray(small, np.float32) / np.float32(255)
        if sigma >= 1 / 3:
            image = np.asarray(cv2.GaussianBlur(image, (0, 0), sigma / times), np.float32)
        return cls(image, np.array([width, height], np.float64) / image.shape[1::-1], low.astype(np.float64))

    def at(self, position: AnyFloat) -> Float64:
        """(..., 2) positions in its pixels of photo pixels (..., 2), centres at +0.5 in both."""
        return (np.asarray(position, np.float64) - self.corner) / self.step
