"""What photos of one head tell each other: the same spot of skin, seen from two sides, lies where both rays meet.

The reader and the landmarks know heads in general and err alike in all photos; two photos of one skin do not. One photo
is brought into the view of another over the head as it is fitted so far. Where the head has the right shape and both
cameras stand right, the two pictures agree; else spots lie beside each other, by the optical flow between them (Kroeger
et al., "Fast Optical Flow using Dense Inverse Search", ECCV 2016). So each spot becomes a point of the surface with its
pixel in either photo, as in bundle adjustment. Light differs between photos: pictures are compared after their local
mean and contrast are taken out, and spots count by how well their surroundings correlate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from service.arrays import Bool, Float32, Float64, Int64, UInt8
from service.colour import luma
from service.face.fit.landmark_fit import linear_points
from service.face.fit.solver import PointTerm, State, linear, project_points
from service.geometry.mesh import vertex_normals
from service.geometry.raster import Raster, rasterise
from service.head.model import HeadModel
from service.image_filters import blurred
from service.robust import geman_mcclure

CELL_M = 0.0007
"""Side of a pixel of the pictures that are compared, metres on the face."""
NEAR, SURROUNDINGS = 2.0, 8.0
"""Standard deviations, cells, of what mean and contrast are taken from, and of what is correlated: a wider mean leaves
shading in the pictures, which differs from light to light; fewer surroundings tell good matches from chance less."""
ANGLES_DEG, BEST_DEG = (8.0, 55.0), 35.0
"""Angles between two views that are compared, and the best: near ones tell no depth, far ones see other skin. Of spots
35 degrees apart 5 % are off by more than 2 mm, of those 70 degrees apart 25 %."""
PROFILE_DEG = 76.5
"""Yaw from which on a photo is not compared: the head is placed too badly there, and pulls the rest astray. Profiles of
90 degrees are placed at 77 to 84 at first, those of 75 at 65 to 76."""
LEAST_NCC, FULL_NCC = 0.3, 0.65
"""Correlation of the surroundings up to which a spot does not count, and from which on it counts fully."""
GATE = 3.0
"""Standard deviations, or medians of what is off, at which a spot's say is quartered (Geman and McClure)."""


@dataclass(frozen=True)
class Picture:
    """One photo around the face, in cells of ``CELL_M``, and the head in it.

    Attributes:
        state: of the fit.
        middle: (2,) principal point, photo pixels.
        corner: (2,) photo pixels of its corner.
        step: photo pixels of a cell.
        grey: (h, w) float32, logarithm of the photo's coded luma.
        raster: the head.
        vertices: (V, 3) metres, head space.
        place: (h, w, 3) metres, head space, of what shows; 0 beside the head.
        face: (h, w) bool: the face, not at a grazing angle.
    """

    state: State
    middle: Float64
    corner: Float64
    step: float
    grey: Float32
    raster: Raster
    vertices: Float64
    place: Float64
    face: Bool

    @classmethod
    def of(cls, photo: UInt8, middle: Float64, head: HeadModel, state: State, vertices: Float64) -> Picture | None:
        """The picture of a photo (H, W, 3) and vertices (V, 3) at a state; None where the face lies beside it."""
        projection = project_points(state, vertices)
        pixels = projection.uv + middle
        region = head.region("face") > 0.5
        low = np.maximum(np.floor(pixels[region].min(0)) - 4, 0).astype(int)
        high = np.minimum(np.ceil(pixels[region].max(0)) + 4, photo.shape[1::-1]).astype(int)
        if (high - low < 16).any():
            return None
        # Longer side of such a picture.
        step = max(state.scale * CELL_M, float((high - low).max()) / 420)
        width, height = (max(int(n), 1) for n in (high - low) / step)
        crop = photo[low[1] : high[1], low[0] : high[0]]
        grey = np.log(luma(crop.astype(np.float32)) + np.float32(8.0))
        way = cv2.INTER_AREA if step > 1 else cv2.INTER_LINEAR
        grey = np.asarray(cv2.resize(blurred(grey, 0.4 * step), (width, height), interpolation=way), np.float32)
        stretch = (high - low) / np.array([width, height])
        raster = rasterise(
            (pixels - low) / stretch, projection.position[:, 2], head.triangles, width, height, perspective=True
        )
        hit = raster.mask
        corners, weights = head.triangles[raster.triangle[hit]], raster.barycentric[hit].astype(np.float64)
        place = np.zeros((height, width, 3))
        place[hit] = (vertices[corners] * weights[..., None]).sum(1)
        normals = vertex_normals(vertices, head.triangles).astype(np.float64) @ state.rotation.T
        view = projection.position / np.linalg.norm(projection.position, axis=1, keepdims=True)
        facing = -(normals * view).sum(1)
        good = np.zeros((height, width), bool)
        # Least cosine of the viewing angle in either photo.
        good[hit] = (region[corners].all(1)) & ((facing[corners] * weights).sum(1) > 0.25)
        return cls(state, middle, low.astype(np.float64), float(stretch.mean()), grey, raster, vertices, place, good)

    @property
    def uneven(self) -> float:
        """How hard the light on the face is: standard deviation of its luma over the mean, but for noise and pores.

        Over the mean, or dim photos would count as even ones; brows and lips are the same in all.
        """
        if not self.face.any():
            return 0.0
        luma_ = blurred(np.exp(self.grey), NEAR)[self.face] - 8.0
        return float(luma_.std() / max(float(luma_.mean()), 1.0))

    def cells(self, points: Float64) -> tuple[Float64, Float64]:
        """(N, 2) cells of head-space points, centres at +0.5, and (N,) their depths, metres."""
        projection = project_points(self.state, points)
        return (projection.uv + self.middle - self.corner) / self.step, projection.position[:, 2]

    def pixels(self, cells: Float64) -> Float64:
        """(N, 2) photo pixels, relative to the principal point, of cells."""
        return np.asarray(cells * self.step + self.corner - self.middle)


def pairs(states: Sequence[State], uneven: Sequence[float]) -> list[tuple[int, int]]:
    """Photos to compare: each with the few others whose direction of view differs by about ``BEST_DEG``.

    Of several from one direction only the least ``uneven`` counts: hard shade, which the rest lacks, pulls it astray.
    """
    squarely = [index for index, state in enumerate(states) if abs(state.yaw_deg) < PROFILE_DEG]
    towards = np.array([state.rotation.T @ (state.translation / np.linalg.norm(state.translation)) for state in states])
    apart = np.degrees(np.arccos(np.clip(towards @ towards.T, -1, 1))) if states else np.zeros((0, 0))
    used: list[int] = []
    for one in sorted(squarely, key=lambda k: (uneven[k], k)):
        used += [one] if all(apart[one, other] >= ANGLES_DEG[0] for other in used) else []
    found: set[tuple[int, int]] = set()
    for one in used:
        beside = [other for other in used if ANGLES_DEG[0] < apart[one, other] < ANGLES_DEG[1]]
        beside = sorted(beside, key=lambda k: (abs(apart[one, k] - BEST_DEG), k))[:2]  # that each is compared with
        found |= {(min(one, other), max(one, other)) for other in beside}
    return sorted(found)


@dataclass(frozen=True)
class Tracks:
    """Spots seen in two photos.

    Attributes:
        corners: (N, 3) vertices of their triangles; weights: (N, 3) barycentric.
        pixels: of each photo, (N, 2) relative to its principal point.
        trust: (N,) in (0, 1].
    """

    corners: Int64
    weights: Float64
    pixels: tuple[Float64, Float64]
    trust: Float64


def tracks(head: HeadModel, one: Picture, other: Picture) -> Tracks | None:
    """Spots of the face that both photos show; None where they share too little."""
    height, width = one.face.shape
    at = np.zeros((height, width, 2), np.float64)
    rows, columns = np.nonzero(one.raster.mask)
    at[rows, columns], depth = other.cells(one.place[rows, columns])
    seen = np.zeros((height, width), bool)
    cell = np.floor(at[rows, columns]).astype(int)
    inside = ((cell >= 0) & (cell < other.face.shape[::-1])).all(1)
    x, y = np.clip(cell, 0, np.array(other.face.shape[::-1]) - 1).T
    # How far behind the nearest surface of the other photo a spot still counts as seen there.
    front = depth < other.raster.depth[y, x] + 0.006
    seen[rows, columns] = inside & front & cv2.dilate(other.face.astype(np.uint8), np.ones((5, 5), np.uint8))[y, x] > 0
    both = seen & one.face
    if int(both.sum()) < 400:
        return None
    where = at.astype(np.float32) - np.float32(0.5)
    moved = cv2.remap(other.grey, where[..., 0], where[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    ours, theirs = _even(one.grey, both), _even(np.asarray(moved, np.float32), both)
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    flow.setPatchSize(16)  # of 8, even skin holds nothing
    flow.setPatchStride(4)
    images = [np.clip(128 + 45 * image, 0, 255).astype(np.uint8) for image in (ours, theirs)]
    still = np.zeros((height, width, 2), np.float32)
    forth = np.asarray(flow.calc(images[0], images[1], still.copy()), np.float32)
    back = np.asarray(flow.calc(images[1], images[0], still), np.float32)
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).astype(np.float32)
    to = (grid + forth).astype(np.float32)
    returned = cv2.remap(back, to[..., 0], to[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    gap = np.linalg.norm(forth + returned, axis=-1)
    matched = cv2.remap(theirs, to[..., 0], to[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    alike = _correlation(ours, np.asarray(matched, np.float32), both)
    # Most distance, cells, between a spot and where the flow forth and back leads.
    trust = np.clip((alike - LEAST_NCC) / (FULL_NCC - LEAST_NCC), 0, 1) * (gap < 1.0)
    lands = cv2.remap(both.astype(np.float32), to[..., 0], to[..., 1], cv2.INTER_LINEAR)
    trust = trust * both * (lands > 0.99)
    # Most spots of a pair.
    stride = max(int(np.ceil(np.sqrt(both.sum() / 1500))), 1)
    lattice = np.zeros_like(both)
    lattice[stride // 2 :: stride, stride // 2 :: stride] = True
    rows, columns = np.nonzero(lattice & (trust > 0.05))
    # Fewest spots of a pair that are followed.
    if len(rows) < 20:
        return None
    landed = cv2.remap(at.astype(np.float32), to[..., 0], to[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    here, there = np.stack([columns, rows], 1).astype(np.float64) + 0.5, landed[rows, columns].astype(np.float64)
    triangle = one.raster.triangle[rows, columns]
    return Tracks(
        head.triangles[triangle].astype(np.int64), one.raster.barycentric[rows, columns].astype(np.float64),
        (one.pixels(here), other.pixels(there)), trust[rows, columns].astype(np.float64),
    )  # fmt: skip


def _even(grey: Float32, inside: Bool) -> Float32:
    """(h, w) a picture without its local mean and contrast, 0 outside."""
    weight = inside.astype(np.float32)
    near = np.maximum(blurred(weight, NEAR), np.float32(1e-3))
    mean = blurred(grey * weight, NEAR) / near
    rest = (grey - mean) * weight
    spread = np.sqrt(np.maximum(blurred(rest * rest, NEAR) / near, 0))
    # Contrast, in log of luminance, below which skin counts as even.
    return np.asarray(rest / (spread + np.float32(0.02)), np.float32)


def _correlation(one: Float32, other: Float32, inside: Bool) -> Float32:
    """(h, w) normalised correlation of the surroundings of each cell, in [-1, 1]; low on even skin."""
    weight = inside.astype(np.float32)

    def mean(values: Float32) -> Float32:
        return blurred(values * weight, SURROUNDINGS)

    floor = np.float32(0.05) * np.maximum(blurred(weight, SURROUNDINGS), np.float32(1e-3))
    return np.asarray(mean(one * other) / np.sqrt((mean(one * one) + floor) * (mean(other * other) + floor)))


def stereo_terms(head: HeadModel, pictures: Sequence[Picture | None]) -> list[list[PointTerm]]:
    """For each photo its residuals at the spots that it shares with others."""
    terms: list[list[PointTerm]] = [[] for _ in pictures]
    there = [index for index, picture in enumerate(pictures) if picture is not None]
    shown = [picture for picture in pictures if picture is not None]
    for a, b in pairs([picture.state for picture in shown], [picture.uneven for picture in shown]):
        found = tracks(head, shown[a], shown[b])
        if found is None:
            continue
        mean, modes = linear_points(head, found.corners, found.weights)
        for place, target in zip((a, b), found.pixels, strict=True):
            state = shown[place].state
            now = project_points(state, linear(mean, modes, state.coefficients)).uv
            # Standard deviation of a spot's place, metres on the face.
            sigma = 0.0004 * state.scale
            off = np.linalg.norm(now - target, axis=1)
            gate = max(GATE * sigma, GATE * float(np.median(off)))
            weight = found.trust * geman_mcclure(off, gate) / sigma**2
            terms[there[place]].append(PointTerm(mean, modes, target, weight))
    return terms
