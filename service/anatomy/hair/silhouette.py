"""Which pixels of a photo a style of hair would cover, and how well that agrees with where the photo shows hair."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from service.anatomy.hair.item import Item
from service.anatomy.hair.skull import EAR_M
from service.arrays import AnyFloat, Float32, Float64, Int64
from service.geometry.camera import Camera
from service.geometry.raster import fragments, interpolate, rasterise
from service.geometry.sampling import sample_chart
from service.head.model import HeadModel

OPAQUE = 0.5
"""Alpha from which a texel of a card counts as hair."""


@dataclass(frozen=True)
class Frame:
    """A part of the photo in which silhouettes are compared, ``side`` pixels wide and high.

    Attributes:
        camera: of the photo.
        place: photo pixels (N, 2) -> pixels of the frame (N, 2).
        side: pixels.
        behind: (side, side) float32 metres, depth of the head without hair; inf beside it.
        scalp: (side, side) float32 in [0, 1], the head's scalp where nothing stands before it.
        below: (side, side) float32 1 below the ears, as the head stands in the photo, 0 above.
    """

    camera: Camera
    place: Callable[[Float64], Float64]
    side: int
    behind: Float32
    scalp: Float32
    below: Float32

    @classmethod
    def of(
        cls, camera: Camera, place: Callable[[Float64], Float64], side: int, head: HeadModel, vertices: AnyFloat,
        scalp: Float32,
    ) -> Frame:  # fmt: skip
        """Draw the head.

        Args:
            camera: of the photo.
            place: photo pixels -> pixels of the frame.
            side: of the frame, pixels.
            head: its topology.
            vertices: (V, 3) metres, with the photo's expression.
            scalp: (V,) soft mask.
        """
        flat, depth = place(camera.project(vertices)), camera.to_camera(vertices)[:, 2]
        drawn = rasterise(flat, depth, head.triangles, side, side, cull=True, perspective=True)
        shown = np.flatnonzero(drawn.mask)
        mask = np.zeros(side * side, np.float32)
        corners = head.triangles[drawn.triangle.ravel()[shown]]
        mask[shown] = interpolate(scalp[:, None], corners, drawn.barycentric.reshape(-1, 3)[shown])[:, 0]
        line = place(camera.project(np.array([[0.0, EAR_M, -0.06], [0.0, EAR_M - 0.05, -0.06]])))
        down = (line[1] - line[0]) / max(float(np.linalg.norm(line[1] - line[0])), 1e-9)
        y, x = np.mgrid[:side, :side] + 0.5
        below = ((x - line[0, 0]) * down[0] + (y - line[0, 1]) * down[1] > 0).astype(np.float32)
        return cls(camera, place, side, drawn.depth, mask.reshape(side, side), below)

    def hair(self, item: Item, points: AnyFloat, behind: float = 0.0) -> tuple[Float32, Float32]:
        """(side, side) float32 1 where a style shows, and there its coordinate from root to tip, 0 elsewhere.

        Args:
            item: the style.
            points: (N, 3) its vertices on the head.
            behind: metres behind the head's surface up to which it is drawn.
        """
        pixel, triangle, share = self.nearest(item, points, behind)
        mask, along = (np.zeros(self.side**2, np.float32) for _ in range(2))
        mask[pixel] = 1.0
        if item.along is not None:
            along[pixel] = interpolate(item.along[:, None], item.triangles[triangle], share)[:, 0]
        return mask.reshape(self.side, -1), along.reshape(self.side, -1)

    def nearest(self, item: Item, points: AnyFloat, behind: float = 0.0) -> tuple[Int64, Int64, Float32]:
        """Pixels (N,) where a style shows, row by row, and there its triangle (N,) and barycentric coordinates (N, 3).

        Args:
            item: the style.
            points: (N, 3) its vertices on the head.
            behind: metres behind the head's surface up to which it is drawn.
        """
        flat, depth = self.place(self.camera.project(points)), self.camera.to_camera(points)[:, 2]
        found = fragments(flat, depth, item.triangles, self.side, self.side, nearer=self.behind + np.float32(behind))
        uv = interpolate(item.uv, item.triangles[found.triangle], found.barycentric)
        solid = np.flatnonzero(sample_chart(item.picture, uv)[:, -1] > 255 * OPAQUE)
        pixel, first = np.unique(found.pixel[solid], return_index=True)
        return pixel, found.triangle[solid[first]], found.barycentric[solid[first]]


def agreement(shown: Float32, mask: Float32, known: Float32) -> float:
    """Intersection over union of soft masks (h, w) in [0, 1], where the photo tells; 0 where both are empty."""
    union = float((np.maximum(shown, mask) * known).sum())
    return float((np.minimum(shown, mask) * known).sum()) / union if union > 0 else 0.0
