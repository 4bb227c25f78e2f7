"""A skeleton for a head: neck, head, jaw and eyes, with the weights by which the skin follows.

Expressions are blendshapes; the joints are for what blendshapes cannot do, turning, and as an alternative for the jaw.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, Float32, Float64
from service.geometry.mesh import normalise
from service.head.model import HeadModel
from service.head.regions import part_vertices, vertex_mask

JOINTS = ("neck", "head", "jaw", "eye_left", "eye_right")
PARENTS = (-1, 0, 1, 1, 1)
"""Index of each joint's parent; -1 is none."""

_NECK, _HEAD, _JAW = 0, 1, 2

EAR_TO_JOINT_M = 0.012
"""The head turns on the neck about as far below the middle of the ears."""

JAW_TURN_DEG = 16.0
"""Turn of the jaw at jawOpen where the head has no lower teeth to measure it by."""


@dataclass(frozen=True)
class Skeleton:
    """Joints in metres, head space, their axes those of the head.

    Attributes:
        positions: (5, 3) float64, in the order of ``JOINTS``.
        weights: (V, 5) float32 by which each vertex of the head follows each joint, summing to 1.
    """

    positions: Float64
    weights: Float32


def skeleton(head: HeadModel, neutral: AnyFloat) -> Skeleton:
    """The skeleton of a neutral head.

    Args:
        head: topology, parts, regions and blendshapes.
        neutral: (V, 3) metres.
    """
    points = np.asarray(neutral, np.float64)
    low, high = points.min(0), points.max(0)
    base = points[points[:, 1] < low[1] + 0.02 * (high[1] - low[1])].mean(0)
    ears = vertex_mask(head, "ear_left", "ear_right") > 0.5
    middle = points[ears].mean(0) if ears.any() else (low + high) / 2
    turning = np.array([0.0, middle[1] - EAR_TO_JOINT_M, middle[2]])
    jaw, share = _jaw(head, points, turning)
    eyes = [_centre(points[part_vertices(head, name)], turning) for name in ("eye_left", "eye_right")]
    positions = np.stack([base * [0, 1, 1], turning, jaw, *eyes])
    return Skeleton(positions, _weights(head, points, positions, share))


def joint_weights(head: HeadModel, joints: Skeleton) -> dict[str, Float32]:
    """(N, 5) weights of each of the head's own parts, in the order of ``service.materials.part.head_parts``."""
    found = {}
    for index, name in enumerate(head.part_names):
        polygons = head.polygons[head.polygon_part == index]
        if len(polygons):
            found[name] = joints.weights[np.unique(polygons[polygons >= 0])]
    return found


def _centre(ball: Float64, otherwise: Float64) -> Float64:
    """Middle of a ball's bounding box, as its vertices are denser in front."""
    return np.asarray((ball.min(0) + ball.max(0)) / 2) if len(ball) else otherwise


def _jaw(head: HeadModel, points: Float64, turning: Float64) -> tuple[Float64, Float64]:
    """Position of the jaw's joint, and (V,) share of each vertex in its turn.

    ``jawOpen`` moves the lower teeth rigidly; the joint lies where that turn about +X has its axis, and the share of
    the skin is how far it goes of the way that the turn would take it.
    """
    moved = np.zeros_like(points)
    if "jawOpen" in head.expression_names:
        moved = head.expression[head.expression_names.index("jawOpen")].astype(np.float64)
    teeth = part_vertices(head, "teeth_lower")
    pivot, angle = turning + np.array([0, -0.005, 0.02]), np.radians(JAW_TURN_DEG)
    if len(teeth) > 2 and np.abs(moved[teeth]).max() > 1e-4:
        pivot, angle = _turn(points[teeth], points[teeth] + moved[teeth], pivot, angle)
    y, z = points[:, 1] - pivot[1], points[:, 2] - pivot[2]
    way = np.stack([np.zeros_like(y), y * (np.cos(angle) - 1) - z * np.sin(angle),
                    y * np.sin(angle) + z * (np.cos(angle) - 1)], 1)  # fmt: skip
    along = np.einsum("vi,vi->v", moved, normalise(way, (0.0, 0.0, 0.0)))
    return pivot, np.clip(along / np.maximum(np.linalg.norm(way, axis=1), 1e-3), 0, 1)


def _turn(before: Float64, after: Float64, pivot: Float64, angle: float) -> tuple[Float64, float]:
    """Axis point and angle of the turn about +X that takes points (N, 3) to others, by least squares in the y-z plane.

    What is hardly a turn leaves ``pivot`` and ``angle`` as they are.
    """
    a, b = before[:, 1:], after[:, 1:]
    p, q = a - a.mean(0), b - b.mean(0)
    found = float(np.arctan2((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum(), (p * q).sum()))
    if abs(found) < np.radians(2):
        return pivot, angle
    turn = np.array([[np.cos(found), -np.sin(found)], [np.sin(found), np.cos(found)]])
    fixed = np.linalg.solve(np.eye(2) - turn, b.mean(0) - turn @ a.mean(0))
    if np.linalg.norm(fixed - pivot[1:]) > 0.06:
        return pivot, found  # a jaw that slides as it opens; its axis is not in the head
    return np.array([0.0, *fixed]), found


def _weights(head: HeadModel, points: Float64, positions: Float64, share: Float64) -> Float32:
    weights = np.zeros((len(points), len(JOINTS)), np.float32)
    below = (positions[_HEAD, 1] - points[:, 1]) / max(positions[_HEAD, 1] - positions[_NECK, 1], 1e-6)
    neck = vertex_mask(head, "neck") * np.clip(below, 0, 1)
    weights[:, _NECK] = neck
    weights[:, _JAW] = (1 - neck) * share
    for index, name in enumerate(head.part_names):
        own = np.unique(head.triangles[head.triangle_part == index])
        joint = {"eye_left": 3, "eye_right": 4, "teeth_lower": _JAW, "tongue": _JAW}.get(name)
        if joint is not None:
            weights[own] = np.eye(len(JOINTS), dtype=np.float32)[joint]
        elif index:
            weights[own] = 0  # with the head
    weights[:, _HEAD] += 1 - weights.sum(1)
    return np.asarray(np.clip(weights, 0, 1), np.float32)
