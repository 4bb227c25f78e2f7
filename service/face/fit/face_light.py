"""The photo blurred for the fit, and the light on the fitted face.

One albedo is assumed of the face's skin, so brows, lips, eyes and beard are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, Bool, Float32, Float64, UInt8
from service.colour import srgb_to_linear
from service.face.fit.landmark_fit import facing
from service.face.fit.pose_state import State, project_points
from service.geometry.normals import vertex_normals
from service.head.model import HeadModel
from service.light.harmonics import estimate_light

BLUR_M = 0.0012
"""Standard deviation of the photo's blur before edges are searched and skin is sampled, metres on the face."""
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

    @classmethod
    def around(cls, pixels: UInt8, middle: Float64, state: State, vertices: Float64) -> Softened:
        """A photo blurred by ``BLUR_M`` around the head whose vertices (V, 3) are those at a state."""
        return cls.of(pixels, BLUR_M * state.scale, project_points(state, vertices).uv + middle)

    def at(self, position: AnyFloat) -> Float64:
        """(..., 2) positions in its pixels of photo pixels (..., 2), centres at +0.5 in both."""
        return (np.asarray(position, np.float64) - self.corner) / self.step
LEFT_OUT = ("lips", "brow_left", "brow_right", "eyelid_left", "eyelid_right", "beard", "eye_socket", "mouth_inner")
"""Regions of the head that are not skin of one albedo."""


def skin_weight(head: HeadModel) -> Float64:
    """(V,) in [0, 1]: face skin without brows, lips, lids and beard."""
    weight = head.region("face").astype(np.float64)
    for name in LEFT_OUT:
        if name in head.region_names:
            weight = weight * (1.0 - head.region(name))
    return np.asarray(weight)


def light_on_face(head: HeadModel, state: State, vertices: Float64, pixels: UInt8, middle: Float64) -> Float64 | None:
    """Light on the visible skin of the fitted face.

    Args:
        head: the head model.
        state: pose.
        vertices: (V, 3) metres at that state.
        pixels: (H, W, 3) uint8 sRGB.
        middle: (2,) principal point in pixels.

    Returns:
        (9, 3) coefficients in the camera frame (x right, y down, z forward), see :func:`estimate_light`; None where
        fewer than 30 vertices of skin are visible or they are black.
    """
    photo = Softened.around(pixels, middle, state, vertices)
    height, width = photo.image.shape[:2]
    projection = project_points(state, vertices)
    normals = vertex_normals(vertices, head.triangles).astype(np.float64)
    where = np.floor(photo.at(projection.uv + middle)).astype(int)
    inside: Bool = np.asarray(((where >= 0) & (where < (width, height))).all(1))
    weight = skin_weight(head) * facing(normals, projection.position, state.rotation) * inside
    # At grazing angles the colour is unreliable.
    view = projection.position / np.maximum(np.linalg.norm(projection.position, axis=1, keepdims=True), 1e-9)
    weight = weight * np.clip(-((normals @ state.rotation.T) * view).sum(1), 0.0, 1.0)
    used = np.flatnonzero(weight > 0.05)
    colour = srgb_to_linear(photo.image[where[used, 1], where[used, 0]]).astype(np.float64)
    return estimate_light(normals[used] @ state.rotation.T, colour, weight[used])
