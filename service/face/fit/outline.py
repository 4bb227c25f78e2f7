"""What the fit takes from the blurred photo: edges along the head's occluding contour, and the light on the face.

On a turned head the silhouette of the far cheek, brow and nose constrains the shape more than any landmark does. Each
point of the model's occluding contour searches the strongest edge along its normal in the photo (the classical active
contour step; for face models: Bas et al., Fitting a 3D Morphable Model to Edges, ACCVW 2016).

For the light one albedo is assumed of the face's skin, so brows, lips, eyes and beard are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, Bool, Float32, Float64, Int32, UInt8
from service.colour import srgb_to_linear
from service.face.fit.landmark_fit import facing, linear_points
from service.face.fit.solver import PointTerm, State, project_points
from service.face.reading.part_labels import BACKGROUND, SKIN
from service.face.reading.reader import Reading, View, parts_at_pixels
from service.face.reading.segments import FACE
from service.geometry.mesh import vertex_normals
from service.geometry.raster import rasterise
from service.head.model import HeadModel
from service.light.formulas import estimate_light
from service.robust import geman_mcclure

BLUR_M = 0.0012
"""Standard deviation of the photo's blur before edges are searched and skin is sampled, metres on the face."""
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
    def around(cls, pixels: UInt8, middle: Float64, state: State, vertices: Float64) -> Softened:
        """SRGB of a photo (H, W, 3) under a Gaussian of ``BLUR_M``, none below a third of a pixel.

        What lies further than ``AROUND`` from the head whose vertices (V, 3) are those at a state is left out.
        """
        import cv2

        head = project_points(state, vertices).uv + middle
        # Largest standard deviation, photo pixels.
        sigma = min(BLUR_M * state.scale, 50.0)
        # A standard deviation keeps at least so many pixels.
        times = max(int(sigma / 4.0), 1)
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


CROWN_REACH_M, CROWN_SIGMA_M = 0.04, 0.0025
"""Half length of the lines on which the end of the skull is searched, and standard deviation of what is found, m."""
RIM = 10.0
"""Weight of the head's rim in several photos, over that of other contour: in photos of rendered heads its edges stray
by 0.4 mm about a mean of 0.1 mm, and nothing tells as much of the middle of a face as the rim of its profile."""
CELL_M, HIDES_M = 0.001, 0.015
"""Cells in which it is looked up what of a contour shows, metres on the face; and how much nearer is what hides some of
it: skin that ends there is nearer by less."""
SAMPLES = 25
"""Samples along each search line, odd."""


@dataclass(frozen=True)
class Outline:
    """Points of the occluding contour.

    Attributes:
        vertices: (N, 2) int, the two ends of each contour edge of the mesh.
        uv: (N, 2) pixels relative to the principal point, the middle of the edge.
        normal: (N, 2) unit, pointing out of the face.
    """

    vertices: Int32
    uv: Float64
    normal: Float64

    def lines(self, offset: Float64) -> Float64:
        """(N, S, 2) pixels along the normals, (S,) offsets from each point."""
        return self.uv[:, None] + offset[None, :, None] * self.normal[:, None]


class OutlineFinder:
    """Finds the occluding contour among the mesh edges of the face or the scalp, and where it belongs in the photo."""

    def __init__(self, head: HeadModel, region: str = "face") -> None:
        self.head = head
        skin = np.flatnonzero(head.triangle_part == head.part_names.index("skin"))
        corners = head.triangles[skin]
        sides = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
        owner = np.tile(skin, 3)
        order = np.lexsort((sides[:, 1], sides[:, 0]))
        sides, owner = sides[order], owner[order]
        pair = np.flatnonzero((sides[1:] == sides[:-1]).all(1))
        self.edges = sides[pair]
        self.sides = np.stack([owner[pair], owner[pair + 1]], 1)
        within = head.region(region)[self.edges].min(1) > 0.5
        self.edges, self.sides = self.edges[within], self.sides[within]
        self.triangles = head.triangles

    def find(self, state: State, vertices: Float64) -> Outline:
        """The occluding contour of (V, 3) vertices in a pose, folds within the face's outline included."""
        projection = project_points(state, vertices)
        uv, position = projection.uv, projection.position
        p = position[self.triangles]
        normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        front = (normal * p.mean(1)).sum(1) < 0
        turning = front[self.sides[:, 0]] != front[self.sides[:, 1]]
        edges = self.edges[turning]
        near = np.where(front[self.sides[turning, 0]], self.sides[turning, 0], self.sides[turning, 1])
        middle = uv[edges].mean(1)
        along = uv[edges[:, 1]] - uv[edges[:, 0]]
        across = np.stack([-along[:, 1], along[:, 0]], 1)
        inside = uv[self.triangles[near]].mean(1) - middle
        across *= -np.sign((across * inside).sum(1, keepdims=True))
        length = np.linalg.norm(across, axis=1)
        keep = length > 1e-6
        return Outline(edges[keep], middle[keep], across[keep] / length[keep, None])

    def seen(self, outline: Outline, state: State, vertices: Float64) -> tuple[Outline, Bool]:
        """What of the contour of (V, 3) vertices they do not hide, and (N,) whether nothing of the head lies beyond."""
        projection = project_points(state, vertices)
        low, high = projection.uv.min(0), projection.uv.max(0)
        # Longer side of what is drawn, where a head right before the camera fills it.
        step = max(CELL_M * state.scale, float((high - low).max()) / 600)
        low = low - 4 * step
        width, height = (int(n) for n in np.ceil((high + 4 * step - low) / step))
        corners, depth = (projection.uv - low) / step, projection.position[:, 2]
        drawn = rasterise(corners, depth, self.triangles, width, height, perspective=True).depth

        def depth_at(cells: float) -> Float32:
            x, y = ((outline.uv + cells * step * outline.normal - low) / step).astype(int).T
            return np.asarray(drawn[y.clip(0, height - 1), x.clip(0, width - 1)])

        own = depth[outline.vertices].mean(1)
        rim: Bool = np.isinf(depth_at(2.0)) & np.isinf(depth_at(4.0))
        shows = rim | ((depth_at(-1.0) > own - HIDES_M) & (depth_at(1.5) > own))
        return Outline(outline.vertices[shows], outline.uv[shows], outline.normal[shows]), rim[shows]

    def term(
        self, photo: Softened, middle: Float64, state: State, vertices: Float64, reach_m: float,
        view: View | None = None,
    ) -> PointTerm | None:  # fmt: skip
        """Residuals between the contour and the edges of the photo, along the contour's normals.

        Args:
            photo: sRGB, blurred to about 1 mm on the face.
            middle: (2,) principal point, pixels.
            state: current pose and coefficients of all of the head's identity and expression.
            vertices: (V, 3) metres at that state.
            reach_m: half length of the search lines, metres on the face.
            view: one of several photos of the head: what the head itself hides is left out then, and where the photo
                was read to show skin before the background, this counts ``RIM`` times.

        Returns:
            The term, or None where no contour point has an edge within reach.
        """
        import cv2

        outline = self.find(state, vertices)
        rim: Bool = np.zeros(len(outline.uv), bool)
        if view is not None:
            outline, rim = self.seen(outline, state, vertices)
        if not len(outline.uv):
            return None
        offset = np.linspace(-1.0, 1.0, SAMPLES) * reach_m * state.scale
        where = photo.at(outline.lines(offset) + middle) - 0.5
        height, width = photo.image.shape[:2]
        x, y = np.moveaxis(where.astype(np.float32), -1, 0)
        lines = cv2.remap(photo.image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        outside: Bool = np.asarray(((where < 0) | (where > np.array([width - 1, height - 1]))).any(-1))
        step = np.linalg.norm(lines[:, 2:] - lines[:, :-2], axis=-1)
        step[outside[:, 1:-1]] = 0.0
        inner = offset[1:-1]
        score = step * np.exp(-0.5 * (inner / (0.5 * reach_m * state.scale)) ** 2)
        best = score.argmax(1)
        strength, shift = step[np.arange(len(best)), best], inner[best]
        # Edge strength (norm of the sRGB difference, components in [0, 1]) at which an edge gets half weight.
        contrast = strength**2 / (strength**2 + 0.04**2)
        # Standard deviation of the distance from the contour to its edge, metres on the face.
        sigma = 0.0008 * state.scale
        weight = contrast * geman_mcclure(shift, 3.0 * sigma)
        if not (weight > 0.01).any():
            return None
        if view is not None and view.reading is not None and rim.any():
            at = (outline.uv + shift[:, None] * outline.normal + middle)[rim]
            # Distance from the edge at which its sides are looked up, metres on the face.
            aside = 0.005 * state.scale * outline.normal[rim]
            skin = parts_at_pixels(view.reading, at - aside)[:, list(FACE)].sum(1)
            weight[rim] *= 1.0 + (RIM - 1.0) * skin * parts_at_pixels(view.reading, at + aside)[:, BACKGROUND]
        return self._drawn(outline, shift, weight, sigma)

    def crown_term(self, reading: Reading, size: tuple[int, int], state: State, vertices: Float64) -> PointTerm | None:
        """Residuals between the contour and the border of what a reading calls the background, along its normals.

        Hair stands off the skull, so the skull ends where the background begins or within it; where bald skin borders
        the background it ends there.

        Args:
            reading: of the photo.
            size: (width, height) of the photo.
            state: current pose and coefficients of all of the head's identity and expression.
            vertices: (V, 3) metres at that state.

        Returns:
            The term, or None where the contour neither reaches into the background nor ends at bald skin.
        """
        outline = self.find(state, vertices)
        if not len(outline.uv):
            return None
        offset = np.linspace(-1.0, 1.0, SAMPLES) * CROWN_REACH_M * state.scale
        at = outline.lines(offset) + np.array(size) / 2
        parts = parts_at_pixels(reading, at.reshape(-1, 2)).reshape(*at.shape[:2], -1)
        crop = (reading.around or reading).region.to_crop(at.reshape(-1, 2), 1).reshape(at.shape)
        inside = ((at >= 0) & (at < size) & (crop > 0) & (crop < 1)).all(-1)
        empty = (parts[..., BACKGROUND] > 0.5) & inside
        first = np.where(empty.any(1), empty.argmax(1), 0)
        here, sample = SAMPLES // 2, np.arange(SAMPLES)
        between = (sample >= here) & (sample < first[:, None])
        bare = ((parts[..., SKIN] > 0.5) | ~between).all(1)
        used = (first > 0) & (inside | (sample > first[:, None])).all(1) & ((first <= here) | bare)
        if not used.any():
            return None
        outline = Outline(outline.vertices[used], outline.uv[used], outline.normal[used])
        return self._drawn(outline, offset[first[used]], np.ones(used.sum()), CROWN_SIGMA_M * state.scale)

    def _drawn(self, outline: Outline, shift: Float64, weight: Float64, sigma: float) -> PointTerm:
        """The contour drawn along its normals by ``shift`` (N,) pixels, known to ``sigma``, each with a weight (N,)."""
        mean, modes = linear_points(self.head, outline.vertices, np.full(outline.vertices.shape, 0.5))
        target = outline.uv + shift[:, None] * outline.normal
        # Weight of one contour point: neighbours see the same edge.
        return PointTerm(mean, modes, target, 0.1 * weight / max(sigma, 1e-9) ** 2, outline.normal)
