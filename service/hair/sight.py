"""The hair of a photo beside the bare head that was fitted to it, on the cells of a square, and strands drawn there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from service.arrays import AnyFloat, Bool, Float32, Float64, Int64
from service.face.fit.fit import Fit
from service.face.region import Region
from service.geometry.camera import NEAREST_M, Camera
from service.geometry.mesh import unit
from service.geometry.raster import rasterise
from service.hair.guides import NAPE_M
from service.hair.kinds import LENGTH_ENDS_M, LENGTHS
from service.hair.reading import CELLS, HairReading
from service.hair.scalp import Roots
from service.head.model import HeadModel
from service.image_filters import blurred, ramp

BEFORE_M = 0.006
"""How far behind the head's surface strands are still drawn: they lie on it, and the fit is no better."""
COVERS = 2.2
"""Strand length in a cell, over the cell's side, at which 10,000 strands cover 1 - 1/e of it."""
SHOWS = (0.25, 0.65)
"""Share of a cell up to which it counts as bare, and from which on as hair."""
SPECK = 12
"""Fewest cells of hair that make a lock: 2 square centimetres."""
EDGE_CELLS = 2.0
"""Cells from the edge of the photo that tell nothing."""
SOFT_CELLS = 0.8
"""Standard deviation of the blur that closes the gaps between the few strands that are drawn."""

HANGS_M, HANGS_WIDE_M = 0.01, 0.015
"""Step of heights at which hair is looked for that hangs below the nape, and the least width of it."""
SHORTER_M, SHORTER = 0.03, 0.02
"""How far above what is seen to hang the ends of a length may lie before it gets no more likely than the second."""


def _specks(covers: Float32) -> Bool:
    """(C, C) cells of hair (C, C) that lie in a patch alone, too small for a lock: an ear-ring, or noise."""
    _, patch, sizes, _ = cv2.connectedComponentsWithStats(np.asarray(covers > 0.5, np.uint8), connectivity=8)
    small = sizes[:, cv2.CC_STAT_AREA] < SPECK
    small[0] = False
    return np.asarray(small[patch])


@dataclass(frozen=True)
class Drawn:
    """Strands in the square.

    Attributes:
        mask: (C, C) float32 in [0, 1], share of the cell that they cover.
        direction: (C, C, 2) float32 mean of their unit directions from root to tip, x right and y down; 0 without
            strands.
    """

    mask: Float32
    direction: Float32


@dataclass(frozen=True)
class Sight:
    """What the photo shows, (C, C) cells.

    Attributes:
        camera: of the photo.
        region: the square.
        hair: float32 in [0, 1], the photo's hair.
        shown: float32 in [0, 1], 0 beside the photo and where something hides whether there is hair.
        known: float32 in [0, 1], 0 where the photo does not tell: where nothing is shown, and where background is shown
            in place of the fitted head.
        direction: (C, C, 2) float32 unit, from root to tip, the square's own axes.
        certainty: float32 in [0, 1], of it.
        behind: float32 metres, depth of the head without hair; inf beside it.
    """

    camera: Camera
    region: Region
    hair: Float32
    shown: Float32
    known: Float32
    direction: Float32
    certainty: Float32
    behind: Float32

    @classmethod
    def of(cls, reading: HairReading, fit: Fit, head: HeadModel) -> Sight:
        """The reading and the fitted head, in its expression."""
        bare = cls.beside(head, fit.vertices, fit.camera, reading.region)
        # What is black beyond the photo counts in the cells at its edge, too.
        margin = EDGE_CELLS * reading.region.side / CELLS
        at, size = reading.cells, np.array([fit.camera.width, fit.camera.height])
        inside = ((at >= margin) & (at < size - margin)).all(1).reshape(CELLS, CELLS)
        # Background where the fitted head is: one of both is wrong, and nothing is told of its hair.
        behind = np.isfinite(bare.behind) * reading.background
        shown = np.asarray(reading.known * inside, np.float32)
        covers = ramp(reading.mask, SHOWS)
        known = np.asarray(shown * (1 - behind) * ~_specks(covers), np.float32)
        return replace(
            bare, hair=covers * known, shown=shown, known=known, direction=reading.direction,
            certainty=reading.certainty,
        )  # fmt: skip

    @classmethod
    def beside(cls, head: HeadModel, vertices: AnyFloat, camera: Camera, region: Region) -> Sight:
        """A head (V, 3) metres without any hair."""
        points, depth = region.to_crop(camera.project(vertices), CELLS), camera.to_camera(vertices)[:, 2]
        drawn = rasterise(points, depth, head.triangles, CELLS, CELLS, cull=True, perspective=True)
        none, behind = np.zeros((CELLS, CELLS), np.float32), np.where(drawn.mask, drawn.depth, np.inf)
        way = np.zeros((CELLS, CELLS, 2), np.float32)
        whole = np.ones_like(none)
        return cls(camera, region, none, whole, whole, way, none, np.asarray(behind, np.float32))

    @property
    def bare(self) -> Float32:
        """(C, C) float32 in [0, 1], 1 where the photo shows that there is no hair."""
        return np.asarray(self.known * (1 - np.clip(2 * self.hair, 0, 1)), np.float32)

    def project(self, points: AnyFloat) -> tuple[Float32, Float32]:
        """Cells (..., 2) and depth (...) metres of points (..., 3) in the head's frame."""
        # Camera and square as one matrix, row by row: a product of matrices would wait for threads.
        camera = self.camera
        to_pixel = np.array([[camera.focal_px, 0, camera.principal_point[0]],
                             [0, camera.focal_px, camera.principal_point[1]], [0, 0, 1]])  # fmt: skip
        to_cell = np.linalg.inv(np.vstack([self.region.matrix(CELLS), [0, 0, 1]]))
        whole = np.concatenate([camera.rotation, camera.translation[:, None]], 1)
        rows = (to_cell @ to_pixel @ whole).astype(np.float32)
        x, y, z = (np.asarray(points[..., k], np.float32) for k in range(3))
        across, down, depth = (row[0] * x + row[1] * y + row[2] * z + row[3] for row in rows)
        near = np.maximum(depth, np.float32(NEAREST_M))
        return np.stack([across / near, down / near], -1), np.asarray(depth, np.float32)

    def placed(self, cells: AnyFloat, depth: AnyFloat) -> Float64:
        """Points (N, 3) metres in the head's frame that are seen in cells (N, 2) at depths (N,): undoes ``project``."""
        camera = self.camera
        pixel = self.region.to_photo(cells, CELLS)
        ray = np.concatenate([(pixel - camera.principal_point) / camera.focal_px, np.ones((len(pixel), 1))], 1)
        return np.asarray((ray * depth[:, None] - camera.translation) @ camera.rotation, np.float64)

    def hanging(self, reading: HairReading) -> HairReading:
        """The reading with lengths unlikely, and ends no higher, than what its own mask shows to hang below the nape.

        The network tells lengths by the whole picture, and knows drawn people only; its mask is right more often.
        """
        y, x = np.mgrid[NAPE_M[0] - HANGS_M : -0.4 : -HANGS_M, -0.16:0.16:0.005]
        at, _ = self.project(np.stack([x, y, np.full_like(x, -0.05)], -1))
        column, row = np.moveaxis(np.clip(at, 0, CELLS - 1).astype(int), -1, 0)
        hair = (self.hair[row, column] > 0.5) & ((at >= 0) & (at < CELLS)).all(-1)
        rows = int(np.append(hair.sum(1) * 0.005 >= HANGS_WIDE_M, False).argmin())
        if rows == 0:
            return reading
        lowest, (ends, doubt) = float(y[rows - 1, 0]), reading.ends_m
        above = np.array([0.0, *LENGTH_ENDS_M, -1.0]) - lowest
        chance = np.array([reading.kinds["length"][name] for name in LENGTHS])
        chance *= np.clip(1 - above / SHORTER_M, SHORTER, 1)
        told = dict(zip(LENGTHS, (chance / chance.sum()).tolist(), strict=True))
        return replace(reading, kinds={**reading.kinds, "length": told}, ends_m=(min(ends, lowest), doubt))

    def facing(self, roots: Roots) -> Float32:
        """(N,) cosine between the skin's normal at roots and the way to the camera: above 0 where it faces it."""
        return np.asarray((roots.normal * unit(self.camera.centre - roots.position)).sum(1), np.float32)

    def visible(self, at: Float32, depth: Float32) -> tuple[tuple[Int64, Int64], Bool]:
        """Row and column of projected points, confined to the square, and whether they lie in it before the head."""
        across, down = at[..., 0], at[..., 1]
        inside = (across >= 0) & (across < CELLS) & (down >= 0) & (down < CELLS)
        rows, columns = (np.clip(each, 0, CELLS - 1).astype(np.int64) for each in (down, across))
        return (rows, columns), np.asarray(inside & (depth < self.behind.take(rows * CELLS + columns) + BEFORE_M))

    def read(self, values: Float32, points: AnyFloat) -> tuple[Float32, Bool]:
        """(...) values (C, C) of the square where points (..., 3) are seen, 0 elsewhere; and whether they are."""
        cell, seen = self.visible(*self.project(points))
        return np.where(seen, values[cell], np.float32(0)), seen

    def drawn(self, strands: Float32) -> Drawn:
        """Strands (N, P, 3) metres as the camera sees them before and beside the head, as if they were 10,000."""
        if not len(strands):
            return Drawn(np.zeros((CELLS, CELLS), np.float32), np.zeros((CELLS, CELLS, 2), np.float32))
        at, depth = self.project(strands)
        begin = [np.ascontiguousarray(part) for part in (at[:, :-1, 0], at[:, :-1, 1], depth[:, :-1])]
        run = [part[:, 1:] - part[:, :-1] for part in (at[..., 0], at[..., 1], depth)]
        length = np.sqrt(run[0] * run[0] + run[1] * run[1])
        pieces = int(np.clip(np.ceil(np.quantile(length, 0.99)), 1, 8))
        limit, cells, places = (self.behind + np.float32(BEFORE_M)).ravel(), [], []
        for share in ((np.arange(pieces) + 0.5) / pieces).astype(np.float32):
            x, y, deep = ((first + share * way).ravel() for first, way in zip(begin, run, strict=True))
            inside = np.flatnonzero((x >= 0) & (x < CELLS) & (y >= 0) & (y < CELLS))
            cell = y[inside].astype(np.int64) * CELLS + x[inside].astype(np.int64)
            seen = np.flatnonzero(deep[inside] < limit[cell])
            cells.append(cell[seen])
            places.append(inside[seen])
        cell, place = np.concatenate(cells), np.concatenate(places)
        sums = [
            np.bincount(cell, (row / pieces).ravel()[place], CELLS * CELLS).reshape(CELLS, CELLS)
            for row in (length, run[0], run[1])
        ]
        dense = blurred(np.stack(sums, -1).astype(np.float32), SOFT_CELLS)
        covered = ramp(1 - np.exp(-dense[..., 0] * 10_000 / len(strands) / COVERS), SHOWS)
        mean = dense[..., 1:] / np.maximum(dense[..., :1], 1e-6)
        return Drawn(np.asarray(covered, np.float32), np.asarray(mean, np.float32))


def overlap(shown: Float32, mask: Float32, known: Float32) -> float:
    """Intersection over union of soft masks (h, w) in [0, 1], where the photo tells; 0 where both are empty."""
    union = float((np.maximum(shown, mask) * known).sum())
    return float((np.minimum(shown, mask) * known).sum()) / union if union > 0 else 0.0
