"""Light inside the mouth: what comes in between the lips.

A point inside sees the world through the opening only. The share of a uniform sky's irradiance that reaches it is the
form factor of the opening's outline, in closed form (Lambert 1760; Baum, Rushmeier and Winget 1989, eq. 5). Without
it teeth deep in the mouth are as bright as in the open, and stand out as white spikes.
"""

from __future__ import annotations

import numpy as np

from service.anatomy.opening_edges import lip_edges
from service.arrays import AnyFloat, Float32, Float64
from service.head.model import HeadModel

PARTS = frozenset({"teeth_upper", "teeth_lower", "teeth_upper_gums", "teeth_lower_gums", "tongue", "tongue_body"})
"""Names of what lies in the mouth."""

ROW = 0
"""Row of the lips, from the lining outwards, that bounds the opening: the innermost, as lips let light through."""

WITHIN = 0.15
"""Share of the light that the flesh around scatters to a point that sees nothing of the opening."""

BLEND_M = 0.003
"""Depth behind the opening from which on the outline is all that counts: before it points see past the lips."""


def light_inside(points: AnyFloat, normals: AnyFloat, outline: AnyFloat) -> Float32:
    """(N,) float32 in [0, 1], share of the light of the open that reaches points.

    Args:
        points: (N, 3).
        normals: (N, 3) unit.
        outline: (M, 3) of the opening, in order, in the same frame; fewer than three points let nothing in.
    """
    if len(outline) < 3:
        return np.full(len(points), WITHIN, np.float32)
    ring = np.asarray(outline, np.float64)
    middle = ring.mean(0)
    area = np.cross(ring - middle, np.roll(ring, -1, 0) - middle).sum(0)
    if area[2] < 0:  # it opens towards +Z, out of the face
        ring, area = ring[::-1], -area
    forward = area / max(float(np.linalg.norm(area)), 1e-18)
    seen = _form_factor(np.asarray(points, np.float64), np.asarray(normals, np.float64), ring)
    depth = (middle - points) @ forward
    behind = np.clip(depth / BLEND_M, 0, 1)
    inside = WITHIN + (1 - WITHIN) * np.clip(seen, 0, 1)
    return np.asarray(1 - behind * (1 - inside), np.float32)


def _form_factor(points: Float64, normals: Float64, ring: Float64) -> Float64:
    """(N,) form factor of a polygon (M, 3) seen from points, positive where its front lies before the normal."""
    total = np.zeros((len(points), 3))
    ray = ring[0] - points
    for k in range(len(ring)):
        after = ring[(k + 1) % len(ring)] - points
        axis = np.cross(ray, after)
        length = np.linalg.norm(axis, axis=1)
        angle = np.arctan2(length, (ray * after).sum(1))
        total += (angle / np.maximum(length, 1e-18))[:, None] * axis
        ray = after
    return np.asarray((total * normals).sum(1) / (2 * np.pi))


def opening(head: HeadModel, vertices: AnyFloat) -> Float64:
    """(M, 3) outline of the opening between the lips of a head (V, 3), in order; none where the head has no lips."""
    edges = lip_edges(head)
    if edges is None:
        return np.zeros((0, 3))
    rows = [np.asarray(vertices, np.float64)[rows[min(ROW, len(rows) - 1)]] for rows in (edges.upper, edges.lower)]
    upper, lower = (row[np.argsort(row[:, 0], kind="stable")] for row in rows)
    return np.concatenate([upper, lower[::-1]])

