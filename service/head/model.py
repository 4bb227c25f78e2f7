"""The parametric head: mean, identity and expression bases, parts, chart coordinates, landmark embedding.

The file format (``.npz`` without pickle) is described in ``docs/head-model.md``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, Float32, Int32, UInt8


@dataclass(frozen=True, eq=False)
class HeadModel:
    """A linear head model in metres, +Y up, +Z out of the face, +X to the subject's left.

    ``vertices(a, e) = mean + sum_k a_k identity[k] + sum_j e_j expression[j]``; identity coefficients are in standard
    deviations, expression coefficients (ARKit units) in [0, 1].

    Attributes:
        name, licence: for the manifest.
        mean: (V, 3) float32 metres, neutral, origin midway between the eyeball centres.
        identity: (K, V, 3) float32 metres per standard deviation, ordered by variance.
        expression: (E, V, 3) float32 metres at full activation.
        expression_names: E names; ARKit's camelCase where the unit is one of the 52.
        polygons: (Q, 4) int32 vertex indices, counter-clockwise from outside; -1 in the last column marks a triangle.
        polygon_uv: (Q, 4) int32 indices into uv, -1 as in polygons.
        polygon_part: (Q,) uint8 index into part_names.
        part_names: "skin" first, then "eye_left", "eye_right", "teeth_upper", "teeth_lower", "tongue", "lashes".
        uv: (U, 2) float32 in [0, 1], origin bottom left, one 3:2 chart shared by all parts.
        mirror: (V,) int32 index of each vertex's mirror partner (itself on the midline).
        triangles, triangle_uv: (T, 3) int32, the polygons split into triangles; triangle_part: (T,) uint8.
        landmark_triangle: (L,) int32 triangle of each landmark (L = 468 for the MediaPipe mesh).
        landmark_barycentric: (L, 3) float32.
        landmark_spread: (L,) float32 metres, scatter of the detector around the embedded point, measured by rendering.
        contour_landmarks: (C,) int32 landmarks that slide over the surface with the pose (face outline).
        contour_yaw_deg: (B,) float32 bin centres; contour_triangle: (B, C) int32;
            contour_barycentric: (B, C, 3) float32.
        region_names: names of soft vertex masks ("face", "lips", "ear_left", "neck", "scalp", ...).
        regions: (R, V) float32 in [0, 1].
    """

    name: str
    licence: str
    mean: Float32
    identity: Float32
    expression: Float32
    expression_names: tuple[str, ...]
    polygons: Int32
    polygon_uv: Int32
    polygon_part: UInt8
    part_names: tuple[str, ...]
    uv: Float32
    mirror: Int32
    triangles: Int32
    triangle_uv: Int32
    triangle_part: UInt8
    landmark_triangle: Int32
    landmark_barycentric: Float32
    landmark_spread: Float32
    contour_landmarks: Int32
    contour_yaw_deg: Float32
    contour_triangle: Int32
    contour_barycentric: Float32
    region_names: tuple[str, ...]
    regions: Float32

    def shape(self, identity: AnyFloat, expression: AnyFloat | None = None) -> Float32:
        """(V, 3) float32 vertices in metres for (k,) identity, k <= K, and (E,) expression coefficients."""
        vertices = self.mean + np.tensordot(np.asarray(identity, np.float32), self.identity[: len(identity)], 1)
        return np.asarray(vertices if expression is None else self.expressed(vertices, expression), np.float32)

    def expressed(self, neutral: AnyFloat, expression: AnyFloat) -> Float32:
        """(V, 3) float32 metres of a neutral face (V, 3) with (E,) expression coefficients."""
        return np.asarray(neutral + np.tensordot(np.asarray(expression, np.float32), self.expression, 1), np.float32)

    @property
    def skin_triangles(self) -> Int32:
        """(T, 3) triangles of the part "skin"."""
        return np.asarray(self.triangles[self.triangle_part == self.part_names.index("skin")])

    def region(self, name: str) -> Float32:
        """(V,) float32 soft mask; KeyError names the regions that exist."""
        if name not in self.region_names:
            raise KeyError(f"no region {name!r}; the head has {', '.join(self.region_names)}")
        return np.asarray(self.regions[self.region_names.index(name)])
