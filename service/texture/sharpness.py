"""How sharp and how noisy a photo is, measured on the face itself.

Blur: a second blur of known width weakens the gradient of a sharp edge more than that of a soft one; at an edge of
standard deviation s, by sqrt(1 + t^2 / s^2) for a blur t (Zhuo and Sim 2011). The sharpest edges of a face, lashes,
brows, the lines of lids and lips, tell what lens, motion, enlargement and denoising left. Noise: the response to a
kernel that neither planes nor straight edges excite (Immerkaer 1996), its median over the face. JPEG: the file's own
steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from service.arrays import AnyFloat, Float32, UInt8
from service.colour import luma
from service.image_filters import blurred

SECOND_BLUR = 1.0
"""Standard deviation t, pixels."""
LEAST_BLUR = 0.35
"""Standard deviation of a pixel's own area and of the best lens, pixels."""
UNKNOWN_BLUR = 2.0
"""Where there are too few edges to tell."""
LEAST_LEFT = 0.1
"""Share of the power left by the blur below which detail counts as lost."""
QUIET = 1 / 255 / np.sqrt(12)
"""Noise of the rounding to 8 bits."""


@dataclass(frozen=True)
class Sharpness:
    """How sharp a photo is about its face.

    Attributes:
        blur: standard deviation of the point spread function, pixels.
        noise: standard deviation of sRGB-coded luma per pixel, taken as white.
        steps: (8, 8) JPEG quantisation steps of luma over 255, row = vertical frequency; None: not a JPEG.
    """

    blur: float
    noise: float
    steps: Float32 | None = None

    def resolved(self, frequency: AnyFloat) -> Float32:
        """Share of the power of detail that is left at frequencies in cycles per pixel, 0 beyond 0.5."""
        left = np.exp(-((2 * np.pi * self.blur * frequency) ** 2))
        return np.asarray(np.where(frequency < 0.5, left, 0), np.float32)

    @property
    def finest(self) -> float:
        """Highest frequency of which the blur leaves ``LEAST_LEFT`` of the power, cycles per pixel, at most 0.5."""
        return min(float(np.sqrt(-np.log(LEAST_LEFT))) / (2 * np.pi * max(self.blur, 1e-3)), 0.5)

    def noise_power(self, frequency: AnyFloat) -> Float32:
        """Variance of noise and quantisation in the octave that begins at ``frequency``, cycles per pixel."""
        begin, end = np.minimum(frequency, 0.5), np.minimum(2 * frequency, 0.5)
        area = np.pi * (end**2 - begin**2)
        white = self.noise**2 * np.minimum(area, 1)
        if self.steps is None:
            return np.asarray(white, np.float32)
        middle = np.clip(np.rint(16 * np.sqrt(2) * begin), 0, 7).astype(int)
        diagonal = self.steps[middle, middle]
        # A coefficient of an orthonormal 8 x 8 transform has the variance of one pixel: power adds over the octave.
        return np.asarray(white + diagonal**2 / 12 * np.minimum(area, 1), np.float32)


def measure_sharpness(face: UInt8, steps: Float32 | None = None) -> Sharpness:
    """Sharpness of a crop (h, w, 3) sRGB that holds the face; a crop too small to tell counts as blurred."""
    if min(face.shape[:2]) < 16:
        return Sharpness(UNKNOWN_BLUR, 0.01, steps)
    grey = luma(face.astype(np.float32)) * np.float32(1 / 255)
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    noise = 1.4826 * float(np.median(np.abs(cv2.filter2D(grey, -1, kernel)))) / 6
    noise = max(noise, QUIET)
    steep = _gradient(grey)
    softer = _gradient(blurred(grey, SECOND_BLUR))
    # Ridges of the gradient: beside them the second blur brings in what the first had not.
    peak = softer >= np.asarray(cv2.dilate(softer, np.ones((3, 3), np.uint8)))
    # 0.01: share of the face's pixels, those of the steepest gradients, that count as edges.
    # 6.0: gradients below so many times the noise's are no edges.
    least = max(float(np.quantile(softer, 1 - 0.01)), 6.0 * noise * 0.2)
    chosen = peak & (softer >= least)
    # Edges with fewer of which the blur is not known.
    if int(chosen.sum()) < 20:
        return Sharpness(UNKNOWN_BLUR, noise, steps)
    ratio = steep[chosen] / np.maximum(softer[chosen], 1e-9)
    blur = SECOND_BLUR / np.sqrt(np.maximum(ratio**2 - 1, 1e-3))
    # Quantile of the edges' blur that counts as the photo's: edges of a face may be soft themselves.
    found = max(float(np.quantile(blur, 0.10)), LEAST_BLUR)
    # Blur, pixels, from which on it is measured at half the size.
    if found > 1.5 and min(face.shape[:2]) >= 64:  # far wider than the second blur, it hardly tells: look at half size
        half = np.asarray(cv2.resize(face, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)
        coarser = measure_sharpness(half).blur
        found = found if coarser == UNKNOWN_BLUR else max(found, 2 * coarser)
    return Sharpness(found, noise, steps)


def _gradient(grey: Float32) -> Float32:
    """(h, w) magnitude of central differences."""
    kernel = np.array([[-0.5, 0, 0.5]], np.float32)
    across, down = cv2.filter2D(grey, -1, kernel), cv2.filter2D(grey, -1, kernel.T)
    return np.asarray(np.sqrt(across * across + down * down), np.float32)
