"""Turn another linear head model into a head file of ours: units, frame, chart, mirror table, landmarks, regions.

The other model brings a neutral, identity components in standard deviations, expression units and polygons with chart
coordinates. Landmarks and regions come from our own head, which is fitted to the other neutral in three dimensions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from models.head.nearest import nearest_on_triangles
from models.head.register import Cloud, Fitter, hidden_behind
from service.errors import ModelFault
from service.geometry.mesh import area_normals
from service.head.files import split_polygons, triangle_fields
from service.head.model import HeadModel

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]

FIT_COMPONENTS, FIT_BOUND = 80, 3.0


@dataclass(frozen=True)
class Source:
    """Another model, as read.

    Attributes:
        name, licence: for the manifest.
        unit_m: metres per unit of the arrays below.
        neutral: (V, 3), +Y up, +Z forward.
        identity: (K, V, 3) per standard deviation.
        expression: (E, V, 3) at full activation; names: E of them, ARKit's where they mean the same.
        polygons, polygon_uv: (Q, 4), -1 pads triangles.
        uv: (U, 2) in [0, 1], already in a 3:2 image.
        eyes: (2, 3) eyeball centres in the model's unit, left (+X) first.
    """

    name: str
    licence: str
    unit_m: float
    neutral: Float
    identity: Float
    expression: Float
    names: tuple[str, ...]
    polygons: Int
    polygon_uv: Int
    uv: Float
    eyes: Float


def mirror_table(vertices: Float, tolerance_m: float = 2e-3) -> Int:
    """(V,) partner of each vertex by position; a vertex without a mutual partner near enough is its own."""
    from scipy.spatial import cKDTree

    distance, partner = cKDTree(vertices).query(vertices * np.array([-1.0, 1.0, 1.0]))
    here = np.arange(len(vertices))
    mutual = (partner[partner] == here) & (distance < tolerance_m)
    return np.where(mutual, partner, here)


def convert(source: Source, ours: HeadModel) -> HeadModel:
    """The source as a head model with landmarks and regions carried over from ours.

    Raises:
        ModelFault: the source's arrays do not fit each other.
    """
    count = len(source.neutral)
    if source.identity.shape[1:] != (count, 3) or source.expression.shape[1:] != (count, 3):
        raise ModelFault(
            f"identity {source.identity.shape} and expression {source.expression.shape} do not fit {count} vertices"
        )
    if source.polygons.max() >= count or source.polygon_uv.max() >= len(source.uv):
        raise ModelFault("polygons point beyond the vertices or the chart")
    mean = (source.neutral - source.eyes.mean(0)) * source.unit_m
    polygons = source.polygons.astype(np.int32)
    polygon_uv = source.polygon_uv.astype(np.int32)
    part = np.zeros(len(polygons), np.uint8)
    triangles = split_polygons(polygons).astype(np.int64)
    ipd = float(np.linalg.norm(source.eyes[0] - source.eyes[1])) * source.unit_m
    transfer = _Transfer(mean, triangles, ours, ipd)
    place = transfer.place(ours.landmark_triangle, ours.landmark_barycentric)
    contour = transfer.place(ours.contour_triangle.ravel(), ours.contour_barycentric.reshape(-1, 3))
    bins = ours.contour_triangle.shape
    return HeadModel(
        name=source.name,
        licence=source.licence,
        mean=mean.astype(np.float32),
        identity=(source.identity * source.unit_m).astype(np.float32),
        expression=(source.expression * source.unit_m).astype(np.float32),
        expression_names=source.names,
        polygons=polygons,
        polygon_uv=polygon_uv,
        polygon_part=part,
        part_names=("skin",),
        uv=source.uv.astype(np.float32),
        mirror=mirror_table(mean).astype(np.int32),
        landmark_triangle=place[0],
        landmark_barycentric=place[1],
        landmark_spread=np.hypot(ours.landmark_spread, 1e-3).astype(np.float32),
        contour_landmarks=ours.contour_landmarks,
        contour_yaw_deg=ours.contour_yaw_deg,
        contour_triangle=contour[0].reshape(bins),
        contour_barycentric=contour[1].reshape(*bins, 3),
        region_names=ours.region_names,
        regions=transfer.regions(ours),
        **triangle_fields(polygons, polygon_uv, part),
    )


class _Transfer:
    """Our head laid over the other neutral, and the way from it to the other's triangles."""

    def __init__(self, mean: Float, triangles: Int, ours: HeadModel, ipd: float) -> None:
        normals = area_normals(mean, triangles)
        eye = 0.5 * ipd
        front = (normals[:, 2] > 0.2) & (np.linalg.norm(mean - [0, -0.55 * ipd, 0.02], axis=1) < 1.5 * ipd)
        front &= np.linalg.norm(np.abs(mean) - [eye, 0, 0], axis=1) > 0.2 * ipd  # neither socket nor eyeball
        front &= ~hidden_behind(mean, front)
        if front.sum() < 200:
            raise ModelFault(f"only {front.sum()} vertices face forward near the eyes: +Y up, +Z forward, right unit?")
        fitter = Fitter(ours)
        fit = fitter.fit(Cloud(mean[front], normals[front]), FIT_COMPONENTS, FIT_BOUND)
        self.rms = float(np.sqrt((fit.distance**2).mean()))
        self.fitted, self.ours = fit.vertices, ours
        self.fitted_normals = area_normals(fit.vertices, ours.triangles)
        self.mean, self.triangles = mean, triangles
        corner = mean[triangles]
        self.corner = corner
        face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        self.face_normals = face / np.maximum(np.linalg.norm(face, axis=1, keepdims=True), 1e-15)

    def place(
        self, triangle: npt.NDArray[np.int32], weight: npt.NDArray[np.float32]
    ) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float32]]:
        """Triangles and barycentric coordinates on the other mesh for points of ours, by nearest agreeing surface."""
        from scipy.spatial import cKDTree

        corners = self.ours.triangles[triangle]
        points = np.einsum("nk,nkc->nc", weight, self.fitted[corners])
        normals = np.einsum("nk,nkc->nc", weight, self.fitted_normals[corners])
        near = cKDTree(self.corner.mean(1)).query(points, k=48)[1]
        flat = near.ravel()
        weights = nearest_on_triangles(self.corner[flat], np.repeat(points, near.shape[1], axis=0)).reshape(
            *near.shape, 3
        )
        foot = np.einsum("nmk,nmkc->nmc", weights, self.corner[near])
        gap = np.linalg.norm(foot - points[:, None], axis=2)
        agree = np.einsum("nkc,nc->nk", self.face_normals[near], normals) > 0.3
        best = np.argmin(np.where(agree | ~agree.any(1, keepdims=True), gap, np.inf), axis=1)
        row = np.arange(len(points))
        chosen = near[row, best]
        return chosen.astype(np.int32), weights[row, best].astype(np.float32)

    def regions(self, ours: HeadModel) -> npt.NDArray[np.float32]:
        """(R, V) our masks at the nearest vertex of our fitted skin that faces the same way."""
        from scipy.spatial import cKDTree

        skin = np.unique(ours.triangles[ours.triangle_part == 0])
        normals = area_normals(self.mean, self.triangles)
        near = skin[cKDTree(self.fitted[skin]).query(self.mean, k=16)[1]]
        agree = np.einsum("nkc,nc->nk", self.fitted_normals[near], normals) > 0.2
        first = np.where(agree.any(1), agree.argmax(1), 0)
        return np.asarray(ours.regions[:, near[np.arange(len(near)), first]], np.float32)
