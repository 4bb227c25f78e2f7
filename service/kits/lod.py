"""Levels of detail: the parts with more and with fewer triangles, each with its texture coordinates and blendshapes.

Finer ones are subdivided first (Catmull and Clark 1978). Triangles are taken away by meshoptimizer, which keeps a
subset of the vertices, so that texture coordinates and blendshapes stay what they were, and collapses both sides of a
cut of the texture together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from service.archive.pieces import Piece
from service.errors import UsageError
from service.geometry.subdivide import Subdivision
from service.materials.part import MeshPart

LEVELS = (24_000, 12_000, 6_000, 2_000)
"""Triangles of the head at LOD 0 to 3, without hair, lashes and other cards, which get fewer in proportion."""

LARGEST_ERROR = 0.2
"""Relative to the size of a part; it only keeps small ones from vanishing."""


def levels_of_detail(parts: Sequence[MeshPart]) -> list[list[MeshPart]]:
    """Parts at each of ``LEVELS``.

    Raises:
        UsageError: meshoptimizer is not installed.
    """
    fine = [subdivided(part) if part.material.alpha == "opaque" else part for part in parts]
    coarse_count = sum(triangles(part) for part in parts if part.material.alpha == "opaque")
    made = []
    for wanted in LEVELS:
        source = fine if wanted > coarse_count else list(parts)
        count = sum(triangles(part) for part in source if part.material.alpha == "opaque")
        solid, cards = min(wanted / max(count, 1), 1.0), min(wanted / LEVELS[0], 1.0)
        made.append([reduced(part, solid if part.material.alpha == "opaque" else cards) for part in source])
    return made


def triangles(part: MeshPart) -> int:
    """How many triangles a part has."""
    polygons = part.polygons
    return len(polygons) + int((polygons[:, 3] >= 0).sum())


def subdivided(part: MeshPart) -> MeshPart:
    """A part after one step of subdivision: smooth where it has displacement, as the skin, and as it was elsewhere."""
    step = Subdivision.of(part.polygons, len(part.neutral))
    chart = Subdivision.of(part.polygons_uv, len(part.uv))
    smooth = step.smooth if part.material.displacement_map is not None else step.linear
    neutral = smooth(part.neutral).astype(np.float32)
    return replace(
        part,
        vertices=neutral,
        neutral=neutral,
        faces=step.quads.astype(np.int32),
        uv=chart.linear(part.uv).astype(np.float32),
        uv_faces=chart.quads.astype(np.int32),
        targets={unit: smooth(offsets).astype(np.float32) for unit, offsets in part.targets.items()},
    )


def reduced(part: MeshPart, share: float) -> MeshPart:
    """A part with about this share of its triangles, one texture coordinate per vertex.

    Raises:
        UsageError: meshoptimizer is not installed.
    """
    piece = Piece.of(part)
    indices = np.ascontiguousarray(piece.triangles.ravel(), np.uint32)
    points = np.ascontiguousarray(part.neutral[piece.vertex], np.float32)
    kept = indices if share >= 1 else _simplified(indices, points, share)
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
    )


def _simplified(indices: np.ndarray, points: np.ndarray, share: float) -> np.ndarray:
    try:
        import meshoptimizer
    except ImportError as error:
        raise UsageError(
            "levels of detail need meshoptimizer: pip install -c requirements.lock -e '.[kits]'", field="for"
        ) from error
    target = max(int(len(indices) * share) // 3 * 3, 12)
    made = np.zeros_like(indices)
    count = meshoptimizer.simplify(
        made, indices, points, target_index_count=target, target_error=LARGEST_ERROR
    )
    return made[:count] if count >= 12 else indices
