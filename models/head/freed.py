"""The lining of the mouth kept out of teeth, gums and tongue where single units and single heads press it in.

What ``lining.py`` does holds for directions away from the axis of the arch. What is left are folds: the floor of the
mouth and the groove behind the lower lip, when the jaw slides or opens. They are all hidden, so they simply give way,
along the gums' normals, by as much as the worst of some heads needs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from models.head.bases import Bases
from models.head.crossing import crossing_pairs
from models.head.heads import some_heads
from service.anatomy.items import Inset
from service.head.files import split_polygons

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int64]

MARGIN_M, STEP_M, ROUNDS = 0.0006, 0.0004, 24
"""Teeth and gums are taken thicker by the first; a vertex gives way in steps, so many times at most."""


def freed(
    bases: Bases, rows: Sequence[Inset], fitted: Float, lining: Int, triangles: Int, expression_names: tuple[str, ...]
) -> Bases:
    """The bases with a lining that gives way.

    Args:
        bases: with teeth in their places and a lining outside them.
        rows: both rows of teeth, and the tongue.
        fitted: (V, 3) metres, the mean head that they were made for.
        lining: vertices of the skin that may move.
        triangles: (T, 3) of the skin.
        expression_names: the 52 units of ARKit.
    """
    mean, expression = bases.mean.copy(), bases.expression.copy()
    may = np.isin(triangles, lining)
    folds = triangles[may.any(1)]
    heads = [np.zeros_like(mean)]
    heads += [np.einsum("k,kvc->vc", head, bases.identity) for head in some_heads(bases.identity)]
    free = np.zeros(len(mean), bool)
    free[lining] = True
    shells = [(row, np.asarray(split_polygons(_four(row.faces)), np.int64)) for row in rows]
    mean += _way(heads, mean, np.zeros_like(mean), folds, free, shells, fitted)
    jaw = expression[expression_names.index("jawOpen")].copy()
    for index, name in enumerate(expression_names):
        base = mean + (jaw if name == "mouthClose" else 0.0)
        if name != "tongueOut":  # the tongue passes the lips
            expression[index] += _way(heads, base, expression[index], folds, free, shells, fitted)
        if name == "jawOpen":
            jaw = expression[index].copy()
    return Bases(mean, bases.identity, expression)


def _four(faces: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    return faces if faces.shape[1] == 4 else np.c_[faces, np.full(len(faces), -1, np.int32)]


def _way(
    heads: Sequence[Float], base: Float, unit: Float, folds: Int, free: npt.NDArray[np.bool_],
    shells: Sequence[tuple[Inset, Int]], fitted: Float,
) -> Float:  # fmt: skip
    """(V, 3) by which the lining gives way in one unit."""
    given = np.zeros_like(base)
    waiting = list(heads)
    for _ in range(ROUNDS):
        push, crossing = np.zeros_like(base), []
        for head in waiting:
            points = base + head + unit + given
            found = np.zeros_like(base)
            for row, faces in shells:
                found += _pushed(points, row.rest.astype(np.float64) + row.moved(points - fitted), folds, faces)
            found[~free] = 0.0
            if found.any():
                crossing.append(head)
            length = np.linalg.norm(found, axis=1, keepdims=True)
            found = STEP_M * found / np.maximum(length, 1e-9)
            more = np.linalg.norm(found, axis=1) > np.linalg.norm(push, axis=1)
            push[more] = found[more]
        if not crossing:
            break
        given, waiting = given + push, crossing
    return given


def _pushed(points: Float, shell: Float, folds: Int, faces: Int) -> Float:
    """(V, 3) sums of the normals of the faces of a shell that the triangles of each vertex cross."""
    a, b, c = (shell[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    thick = np.zeros_like(shell)
    for k in range(3):
        np.add.at(thick, faces[:, k], normal)
    thick = shell + MARGIN_M * thick / np.maximum(np.linalg.norm(thick, axis=1, keepdims=True), 1e-12)
    both = np.concatenate([points, thick])
    pairs = crossing_pairs(both, folds, faces + len(points))
    out = np.zeros_like(points)
    unit = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    for k in range(3):
        np.add.at(out, folds[pairs[:, 0], k], unit[pairs[:, 1]])
    return out
