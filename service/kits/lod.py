"""Levels of detail: the parts with more and with fewer triangles, each with its texture coordinates and blendshapes.

Of finer ones the skin is subdivided_part first (Catmull and Clark 1978). Coarser ones keep a subset of the vertices
(``service.geometry.remesh``), so that texture coordinates, joints and blendshapes stay what they were; the shape is
kept at rest and in the poses of ``JUDGED``. Of hair fewer ribbons are kept, whole ones, and they get wider: half a
ribbon has no tip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from service.archive.surfaces import Piece
from service.arrays import Float32, Int64
from service.geometry.remesh import Subdivision, collapsed
from service.materials.part import MeshPart, part_triangles

LEVELS = (24_000, 12_000, 6_000, 2_000)
"""Triangles of the head at LOD 0 to 3, without hair, lashes and other cards, which get fewer in proportion."""

WIDEST = 2.0
"""Most by which ribbons of hair get wider."""

JUDGED: tuple[tuple[str, ...], ...] = (
    ("jawOpen",), ("eyeBlinkLeft", "eyeBlinkRight", "mouthSmileLeft", "mouthSmileRight", "browInnerUp"),
    ("mouthPucker", "browDownLeft", "browDownRight"),
)  # fmt: skip
"""Poses, each of units at 1, in which a reduced surface keeps its shape too."""


def levels_of_detail(parts: Sequence[MeshPart]) -> list[list[MeshPart]]:
    """Parts at each of ``LEVELS``."""
    coarse_count = sum(triangles(part) for part in parts if part.material.alpha == "opaque")
    finer = [subdivided_part(part) if part.material.displacement_map is not None else part for part in parts]
    made: list[list[MeshPart]] = []
    for source, levels in (
        (finer, [wanted for wanted in LEVELS if wanted > coarse_count]),
        (parts, [wanted for wanted in LEVELS if wanted <= coarse_count]),
    ):
        count = sum(triangles(part) for part in source if part.material.alpha == "opaque")
        solid = [min(wanted / max(count, 1), 1.0) for wanted in levels]
        cards = [min(wanted / LEVELS[0], 1.0) for wanted in levels]
        columns = [reduced(part, solid if part.material.alpha == "opaque" else cards) for part in source]
        made += [[column[number] for column in columns] for number in range(len(levels))]
    return made


def triangles(part: MeshPart) -> int:
    """How many triangles a part has."""
    polygons = part.polygons
    return len(polygons) + int((polygons[:, 3] >= 0).sum())


def subdivided_part(part: MeshPart) -> MeshPart:
    """A part after one smooth step of subdivision."""
    step = Subdivision.of(part.polygons, len(part.neutral))
    chart = Subdivision.of(part.polygons_uv, len(part.uv))
    neutral = step.smooth(part.neutral).astype(np.float32)
    return replace(
        part,
        vertices=neutral,
        neutral=neutral,
        faces=step.quads.astype(np.int32),
        uv=chart.linear(part.uv).astype(np.float32),
        uv_faces=chart.quads.astype(np.int32),
        targets={unit: step.smooth(offsets).astype(np.float32) for unit, offsets in part.targets.items()},
        normals=None,  # of the finer surface
    )


def reduced(part: MeshPart, shares: Sequence[float]) -> list[MeshPart]:
    """A part with about each share, descending, of its triangles, one texture coordinate per vertex."""
    if part.normals is not None and part.uv_faces is None:
        return [_fewer_ribbons(part, share) for share in shares]
    piece = Piece.of(part)
    wanted = [max(round(len(piece.triangles) * share), 4) for share in shares]
    return [_with(part, piece, kept) for kept in collapsed(_poses(part), piece.triangles, piece.vertex, wanted)]


def _fewer_ribbons(part: MeshPart, share: float) -> MeshPart:
    """Hair with a share of its ribbons, spread evenly over it, wider by so much that they cover as much."""
    triangles = part_triangles(part.polygons)
    count = len(part.neutral)
    ends = triangles[:, :2].ravel(), triangles[:, 1:].ravel()
    edges = coo_matrix((np.ones(len(ends[0])), ends), (count, count))
    pieces, label = connected_components(edges, directed=False)
    # A ribbon has two triangles fewer than vertices; the cap over the scalp has more, and is kept.
    ribbon = np.bincount(label[triangles[:, 0]], minlength=pieces) == np.bincount(label) - 2
    number = np.cumsum(ribbon)
    kept = ~ribbon | (np.floor(number * share) > np.floor((number - 1) * share))
    points = part.neutral.copy()
    # Both sides of a row follow each other.
    rows = np.flatnonzero(ribbon[label])[::2]
    middle = 0.5 * (points[rows] + points[rows + 1])
    wider = np.float32(min(share**-0.5, WIDEST))
    for side in (0, 1):
        points[rows + side] = middle + wider * (points[rows + side] - middle)
    used, index = np.unique(triangles[kept[label[triangles[:, 0]]]], return_inverse=True)
    normals = None if part.normals is None else part.normals[used]
    return replace(
        part, vertices=points[used], neutral=points[used], faces=index.reshape(-1, 3).astype(np.int32),
        uv=part.uv[used], normals=normals,
    )  # fmt: skip


def _with(part: MeshPart, piece: Piece, kept: Int64) -> MeshPart:
    """The part with some triangles (M, 3) of its piece."""
    used, index = np.unique(kept, return_inverse=True)
    vertex = piece.vertex[used]
    return replace(
        part,
        vertices=part.neutral[vertex],
        neutral=part.neutral[vertex],
        faces=index.reshape(-1, 3).astype(np.int32),
        uv=piece.uv[used],
        uv_faces=None,
        targets={unit: offsets[vertex] for unit, offsets in part.targets.items()},
        normals=None if part.normals is None else part.normals[vertex],
    )


def _poses(part: MeshPart) -> list[Float32]:
    """The part at rest, and in each pose of ``JUDGED`` that moves it."""
    moving = ([part.targets[unit] for unit in units if unit in part.targets] for units in JUDGED)
    return [part.neutral, *(np.asarray(part.neutral + sum(offsets), np.float32) for offsets in moving if offsets)]
