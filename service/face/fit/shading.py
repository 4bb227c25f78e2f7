"""Shape from shading: a term of the fit that turns the head's normals towards the shading in the blurred photo.

The skin is modelled as one albedo times spherical-harmonic irradiance, and the difference to the photo is attributed to
the normals. Albedo varies too, so the term has little weight, and brows, lips, eyes and beard are left out. The
derivative goes through the normals alone; where vertices project to is left to the landmark terms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.arrays import AnyFloat, Bool, Float32, Float64, Int32, UInt8
from service.colour import srgb_to_linear
from service.face.fit.basis import LandmarkModel
from service.face.fit.landmark_fit import facing
from service.face.fit.state import POSE, State, project
from service.geometry.normals import cross, vertex_normals
from service.head.model import HeadModel
from service.light.harmonics import BAND_GAIN, LUMINANCE, estimate_light, gradient, sh_basis
from service.robust import geman_mcclure

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


SIGMA = 0.10
"""Standard deviation of the log intensity about one-albedo shading."""
SHARE = 0.01
"""Weight of one vertex: the albedo errors of neighbours are correlated."""
LEFT_OUT = ("lips", "brow_left", "brow_right", "eyelid_left", "eyelid_right", "beard", "eye_socket", "mouth_inner")
"""Regions of the head that are not skin of one albedo."""


@dataclass(frozen=True)
class ShadingTerm:
    """Linearised shading residual r0 + J (x - x0) over the identity coefficients.

    Attributes:
        residual: (N,) at the start, weighted.
        jacobian: (N, K) weighted.
        start: (K,) coefficients of the linearisation.
    """

    residual: Float64
    jacobian: Float64
    start: Float64

    def _at(self, state: State) -> Float64:
        return np.asarray(self.residual + self.jacobian @ (state.coefficients[: len(self.start)] - self.start))

    def cost(self, state: State) -> float:
        """Half the weighted sum of squares."""
        r = self._at(state)
        return 0.5 * float(r @ r)

    def add(self, state: State, hessian: Float64, gradient: Float64) -> None:
        """Add J^T J and J^T r in place."""
        block = slice(POSE, POSE + len(self.start))
        hessian[block, block] += self.jacobian.T @ self.jacobian
        gradient[block] += self.jacobian.T @ self._at(state)


def skin_weight(head: HeadModel) -> Float64:
    """(V,) in [0, 1]: face skin without brows, lips, lids and beard."""
    weight = head.region("face").astype(np.float64)
    for name in LEFT_OUT:
        if name in head.region_names:
            weight = weight * (1.0 - head.region(name))
    return np.asarray(weight)


def normal_derivative(
    vertices: Float64,
    modes: Float32,
    triangles: Int32,
    chosen: npt.NDArray[np.intp],
) -> Float64:
    """(N, 3, K) derivative of the area-weighted unit normals of chosen vertices by the modes' coefficients.

    Args:
        vertices: (V, 3) metres.
        modes: (K, V, 3) metres per unit.
        triangles: (T, 3).
        chosen: (N,) vertex indices; a vertex without area gets zero.
    """
    from scipy.sparse import csr_matrix

    row_of = np.full(len(vertices), -1)
    row_of[chosen] = np.arange(len(chosen))
    near = triangles[(row_of[triangles] >= 0).any(1)]
    if not len(near):
        return np.zeros((len(chosen), 3, len(modes)))
    a, b, c = vertices[near].transpose(1, 0, 2)
    da, db, dc = (np.ascontiguousarray(np.moveaxis(modes[:, near[:, i]], 0, 1)) for i in range(3))  # (T, K, 3)
    change = cross(db - da, (c - a)[:, None]) + cross((b - a)[:, None], dc - da)
    rows = row_of[near].ravel()
    columns = np.repeat(np.arange(len(near)), 3)
    inside = rows >= 0
    gather = csr_matrix((np.ones(int(inside.sum())), (rows[inside], columns[inside])), (len(chosen), len(near)))
    total = gather @ np.cross(b - a, c - a)
    length = np.linalg.norm(total, axis=1)
    flat = length < 1e-15
    unit = total / np.where(flat, 1.0, length)[:, None]
    slope = np.asarray(gather @ change.reshape(len(near), -1)).reshape(len(chosen), len(modes), 3)
    slope -= (slope @ unit[:, :, None]) * unit[:, None]
    slope /= np.where(flat, np.inf, length)[:, None, None]
    return np.ascontiguousarray(np.moveaxis(slope, 1, 2))


@dataclass(frozen=True)
class SkinSamples:
    """Visible skin vertices and their colour in the photo.

    Attributes:
        vertex: (N,) indices.
        normal: (N, 3) unit, head frame.
        colour: (N, 3) linear RGB in [0, 1].
        weight: (N,) in (0.05, 1].
    """

    vertex: npt.NDArray[np.intp]
    normal: Float64
    colour: Float64
    weight: Float64


def seen_skin(head: HeadModel, photo: Softened, middle: Float64, state: State, vertices: Float64) -> SkinSamples:
    """Sample the photo at the visible vertices of the face's skin.

    Args:
        head: the head model.
        photo: the photo.
        middle: (2,) principal point in pixels.
        state: pose.
        vertices: (V, 3) metres at that state.
    """
    height, width = photo.image.shape[:2]
    projection = project(state, vertices)
    normals = vertex_normals(vertices, head.triangles).astype(np.float64)
    where = np.floor(photo.at(projection.uv + middle)).astype(int)
    inside: Bool = np.asarray(((where >= 0) & (where < (width, height))).all(1))
    weight = skin_weight(head) * facing(normals, projection.position, state.rotation) * inside
    # At grazing angles the colour is unreliable; there the contour term constrains the shape.
    view = projection.position / np.maximum(np.linalg.norm(projection.position, axis=1, keepdims=True), 1e-9)
    weight = weight * np.clip(-((normals @ state.rotation.T) * view).sum(1), 0.0, 1.0)
    used = np.flatnonzero(weight > 0.05)
    colour = srgb_to_linear(photo.image[where[used, 1], where[used, 0]]).astype(np.float64)
    return SkinSamples(used, normals[used], colour, weight[used])


def light_on_face(
    head: HeadModel, photo: Softened, middle: Float64, state: State, vertices: Float64
) -> Float64 | None:
    """Light on the fitted face; the arguments are those of :func:`seen_skin`.

    Returns:
        (9, 3) coefficients in the camera frame (x right, y down, z forward), see :func:`estimate_light`; None where
        fewer than 30 vertices of skin are visible or they are black.
    """
    skin = seen_skin(head, photo, middle, state, vertices)
    return estimate_light(skin.normal @ state.rotation.T, skin.colour, skin.weight)


def shading_term(
    head: HeadModel,
    model: LandmarkModel,
    photo: Softened,
    middle: Float64,
    state: State,
    vertices: Float64,
) -> ShadingTerm | None:
    """Shading term at a state.

    Args:
        head: the head model.
        model: how many of its components are fitted.
        photo: the photo.
        middle: (2,) principal point in pixels.
        state: current pose and shape.
        vertices: (V, 3) metres at that state.

    Returns:
        The term, or None where no light can be estimated.
    """
    skin = seen_skin(head, photo, middle, state, vertices)
    light = estimate_light(skin.normal, skin.colour, skin.weight)
    if light is None:
        return None
    grey = light @ LUMINANCE
    seen = skin.colour @ LUMINANCE
    shaded = np.maximum(sh_basis(skin.normal) @ grey, 0.05)
    albedo = float(np.median(seen / shaded))
    residual = np.log(np.maximum(shaded * albedo, 1e-3)) - np.log(np.maximum(seen, 1e-3))
    robust = geman_mcclure(residual, 2.5 * SIGMA)
    root = np.sqrt(SHARE * skin.weight * robust) / SIGMA
    slope = gradient(skin.normal, BAND_GAIN * grey) * (shaded > 0.05)[:, None] / shaded[:, None]
    rotation = normal_derivative(vertices, head.identity[: model.identity_count], head.triangles, skin.vertex)
    jacobian = np.einsum("ni,nik->nk", slope, rotation)
    return ShadingTerm(residual * root, jacobian * root[:, None], state.coefficients[: model.identity_count].copy())
