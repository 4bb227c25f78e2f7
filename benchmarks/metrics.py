"""How far a fitted head is from the truth of a rendered photo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from service.face.fit.fit import Fit
from service.geometry.mesh import normalise, vertex_normals
from service.geometry.raster import Raster, rasterise
from service.head.model import HeadModel

Float = npt.NDArray[np.float64]

INTER_OCULAR_MM = 63.0
"""Every face is scaled to this distance of the pupils: the absolute size cannot be seen in a photo."""
FACE_RADIUS = 1.45
"""Radius of the scored face about its centre, inter-ocular distances."""
FACING = 0.35
MOUTH_BELOW = 1.05
"""Height of the mouth below the pupils, inter-ocular distances."""
ROUNDS = 10
SAMPLES = 2000
"""Points of the true face that are compared."""
SPARSE = 20_000
"""Points of our surface in the first rounds; the last ones, and the distance itself, take all."""


@dataclass(frozen=True)
class Truth:
    """What the renderer knows; see ``benchmarks.render``."""

    position: Float
    normal: Float
    mask: npt.NDArray[np.bool_]
    eyes: npt.NDArray[np.int64]
    yaw: float

    @classmethod
    def load(cls, path: str) -> Truth:
        """Read a ``.npz`` of the photo benchmark."""
        with np.load(path, allow_pickle=False) as data:
            position, normal = data["position"].astype(np.float64), data["normal"].astype(np.float64)
            return cls(position, normal, data["mask"], data["eyes"], float(data["yaw"]))


@dataclass(frozen=True)
class Score:
    """Errors of one fit; millimetres are at 63 mm inter-ocular distance.

    Attributes:
        median_mm, mean_mm: distance of the true face's points to the nearest of ours, after a similarity ICP.
        same_pixel_mm: median distance of what both show at the same pixel, aligned by these pairs alone.
        normal_deg: mean angle between the normals at the same pixel.
        silhouette_iou: overlap of the heads in the photo; jaw_iou: between the eyes and the chin only, in [0, 1].
        width_percent: width of the silhouette at the mouth over the true one, less 100; NaN on a turned head.
    """

    median_mm: float
    mean_mm: float
    same_pixel_mm: float
    normal_deg: float
    silhouette_iou: float
    jaw_iou: float
    width_percent: float


def similarity(source: Float, target: Float) -> tuple[float, Float, Float]:
    """(scale, rotation, offset) with ``scale * source @ rotation + offset`` nearest to target (Umeyama 1991).

    Scale one and no rotation where all source points coincide.
    """
    a, b = source.mean(0), target.mean(0)
    spread = float(((source - a) ** 2).sum())
    if spread < 1e-18:
        return 1.0, np.eye(3), b - a
    u, s, vt = np.linalg.svd((source - a).T @ (target - b))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt)) or 1.0])
    rotation = u @ np.diag(sign) @ vt
    scale = float((s * sign).sum() / spread)
    return scale, rotation, b - scale * a @ rotation


def aligned_distance(surface: Float, matched: tuple[Float, Float], truth: Float) -> Float:
    """Distances from truth (N, 3) to a dense surface (M, 3) after a trimmed similarity ICP that starts from matches."""
    scale, rotation, offset = similarity(*matched)
    sparse = surface[:: max(1, len(surface) // SPARSE)]
    for round_ in range(ROUNDS):
        cloud = sparse if round_ < ROUNDS - 3 else surface
        distance, nearest = cKDTree(scale * cloud @ rotation + offset).query(truth)
        keep = distance <= np.percentile(distance, 90)
        scale, rotation, offset = similarity(cloud[nearest[keep]], truth[keep])
    return np.asarray(cKDTree(scale * surface @ rotation + offset).query(truth)[0])


def face_region(position: Float, normal: Float, eyes: Float, yaw: float) -> npt.NDArray[np.bool_]:
    """(H, W) where a photo shows the face squarely enough to be scored.

    Args:
        position: (H, W, 3) metres of what pixels show, head frame.
        normal: (H, W, 3) unit.
        eyes: (2, 3) metres.
        yaw: degrees of ``benchmarks.render.Shot``.
    """
    turn, apart = np.radians(yaw), float(np.linalg.norm(eyes[0] - eyes[1]))
    view = np.array([np.sin(turn), 0.05, np.cos(turn)])
    centre = eyes.mean(0) - 0.55 * apart * np.array([0.0, 1.0, 0.0])
    near = np.linalg.norm(position - centre, axis=-1) < FACE_RADIUS * apart
    return np.asarray(near & (normal @ (view / np.linalg.norm(view)) > FACING))


def seen_by(fit: Fit, head: HeadModel, width: int, height: int, scale: float = 1.0) -> Raster:
    """What the fit's camera sees of the fitted head; ``scale``: of the picture over the photo that was fitted."""
    depth = fit.camera.to_camera(fit.vertices)[:, 2]
    pixels = scale * fit.camera.project(fit.vertices)
    return rasterise(pixels, depth, head.triangles, width, height, perspective=True)


@dataclass(frozen=True)
class View:
    """The fitted head as its camera sees it, (H, W) pixels.

    Attributes:
        uv: (H, W, 2) chart coordinates, origin bottom left; 0 beside the head.
        points: (H, W, 3) metres, head space.
        skin: bool, the head's skin shows.
    """

    uv: Float
    points: Float
    skin: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, fit: Fit, head: HeadModel, shape: tuple[int, int], scale: float = 1.0) -> View:
        """Of (height, width) pixels, ``scale`` times the photo that was fitted."""
        height, width = shape
        raster = seen_by(fit, head, width, height, scale)
        hit, triangle = raster.mask, raster.triangle[raster.mask]
        weights = raster.barycentric[hit][..., None]
        uv, points, skin = np.zeros((height, width, 2)), np.zeros((height, width, 3)), hit.copy()
        uv[hit] = (head.uv[head.triangle_uv[triangle]] * weights).sum(1)
        points[hit] = (fit.vertices[head.triangles[triangle]] * weights).sum(1)
        skin[hit] = head.triangle_part[triangle] == head.part_names.index("skin")
        return cls(uv, points, skin)

    def of_map(self, plane: npt.NDArray[np.floating]) -> Float:
        """(H, W, C) of a map (h, w, C) on the chart, interpolated."""
        return at_chart(plane, self.uv)


_LONGEST = 30_000
"""Rows that OpenCV remaps at a time: it counts them in 16 bits."""


def at_chart(plane: npt.NDArray[np.floating], uv: Float) -> Float:
    """(..., C) values of a map (h, w, C) at chart coordinates (..., 2), origin bottom left; bilinear."""
    import cv2

    flat, source = uv.reshape(-1, 2), plane.astype(np.float32)
    x = (flat[:, :1] * plane.shape[1] - 0.5).astype(np.float32)
    y = ((1 - flat[:, 1:]) * plane.shape[0] - 0.5).astype(np.float32)
    values = np.zeros((len(flat), *plane.shape[2:]))
    for first in range(0, len(flat), _LONGEST):
        part = slice(first, first + _LONGEST)
        found = cv2.remap(source, x[part], y[part], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        values[part] = found.reshape(len(found), *plane.shape[2:])
    return values.reshape(*uv.shape[:-1], *plane.shape[2:])


def score(fit: Fit, head: HeadModel, truth: Truth) -> Score:
    """Compare what the fitted head shows to the camera with what the renderer's head showed.

    Raises:
        ValueError: the fitted head and the true face share no pixel.
    """
    height, width = truth.mask.shape
    raster, in_camera = seen_by(fit, head, width, height), fit.camera.to_camera(fit.vertices)
    hit = raster.mask
    ours = np.zeros((height, width, 3))
    ours[hit] = (in_camera[head.triangles[raster.triangle[hit]]] * raster.barycentric[hit][..., None]).sum(1)
    ours *= np.array([1.0, -1.0, -1.0])
    pupils = truth.position[truth.eyes[:, 1], truth.eyes[:, 0]]
    inter_ocular = float(np.linalg.norm(pupils[0] - pupils[1]))
    face = truth.mask & face_region(truth.position, truth.normal, pupils, truth.yaw)
    both = face & hit
    if int(both.sum()) < 100:
        raise ValueError(f"the fitted head and the true face share {int(both.sum())} pixels; at least 100 are needed")
    visible, true = ours[hit], truth.position[face]
    distance = aligned_distance(
        visible,
        (ours[both], truth.position[both]),
        true[:: max(1, len(true) // SAMPLES)],
    )
    mm = distance / inter_ocular * INTER_OCULAR_MM
    scale, rotation, offset = similarity(ours[both], truth.position[both])
    apart = np.linalg.norm(scale * ours[both] @ rotation + offset - truth.position[both], axis=1)
    corner = vertex_normals(fit.vertices, head.triangles)[head.triangles[raster.triangle[both]]]
    normal = normalise((corner * raster.barycentric[both][..., None]).sum(1))
    turned = (normal @ fit.camera.rotation.T) * [1.0, -1.0, -1.0] @ rotation
    angle = np.degrees(np.arccos(np.clip((turned * truth.normal[both]).sum(1), -1.0, 1.0)))
    jaw = np.zeros_like(hit)
    jaw[int(truth.eyes[:, 1].mean()) : int(np.flatnonzero(face.any(1)).max()) + 1] = True
    return Score(
        float(np.median(mm)), float(mm.mean()), float(np.median(apart)) / inter_ocular * INTER_OCULAR_MM,
        float(angle.mean()), _overlap(hit, truth.mask), _overlap(hit & jaw, truth.mask & jaw),
        _width_percent(hit, truth),
    )  # fmt: skip


def _overlap(one: npt.NDArray[np.bool_], other: npt.NDArray[np.bool_]) -> float:
    return float((one & other).sum() / max(int((one | other).sum()), 1))


def _width_percent(hit: npt.NDArray[np.bool_], truth: Truth) -> float:
    """By how many percent our head is wider than the true one where the mouth lies; NaN beyond 10 degrees of yaw."""
    if abs(truth.yaw) > 10:
        return float("nan")
    left, right = truth.eyes
    row = round(float(left[1] + right[1]) / 2 + MOUTH_BELOW * float(np.linalg.norm(right - left)))
    rows = slice(max(row - 2, 0), row + 3)
    ours, true = hit[rows].sum(1).mean(), truth.mask[rows].sum(1).mean()
    return float(100.0 * (ours / true - 1.0)) if true > 0 else float("nan")
