"""The bust an avatar ends in: shoulders of the base mesh, cut along a plane."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.anatomy.items import Item

Float = npt.NDArray[np.float64]

FRONT_M, BACK_M = (-0.232, 0.01), (-0.187, -0.14)
"""Heights of the plane that cuts the shoulders off, and the depths where it has them: under the collar bones in front,
over the shoulder blades behind."""


def inside(points: Float) -> Float:
    """(N,) above 0 on the side of points (N, 3) that stays."""
    slope = (FRONT_M[0] - BACK_M[0]) / (FRONT_M[1] - BACK_M[1])
    return np.asarray(points[:, 1] - FRONT_M[0] - slope * (points[:, 2] - FRONT_M[1]))


def cut_item(item: Item, value: Float) -> Item:
    """The part of an item where ``value`` (N,) > 0; triangles across the line are cut along it.

    Positions, texture coordinates and what a vertex follows are interpolated, so the cut moves with the head as the
    whole item does.
    """
    width = item.share.shape[1]
    rows = [np.c_[item.rest, item.uv].astype(np.float64), value[:, None]]
    follow, share = [item.follow], [item.share.astype(np.float64)]
    between: dict[tuple[int, int], int] = {}
    made: list[tuple[int, int, float]] = []

    def crossing(a: int, b: int) -> int:
        key = (min(a, b), max(a, b))
        if key not in between:
            t = value[key[0]] / (value[key[0]] - value[key[1]])
            between[key] = len(item.rest) + len(made)
            made.append((*key, float(t)))
        return between[key]

    faces = []
    for triangle in item.triangles.tolist():
        ring: list[int] = []
        for a, b in zip(triangle, triangle[1:] + triangle[:1], strict=True):
            if value[a] > 0:
                ring.append(a)
            if (value[a] > 0) != (value[b] > 0):
                ring.append(crossing(a, b))
        faces += [(ring[0], ring[k], ring[k + 1]) for k in range(1, len(ring) - 1)]
    if made:
        a, b = (np.array([m[k] for m in made], np.int64) for k in (0, 1))
        t = np.array([m[2] for m in made])[:, None]
        rows[0] = np.concatenate([rows[0], rows[0][a] * (1 - t) + rows[0][b] * t])
        both = np.c_[item.follow[a], item.follow[b]], np.c_[item.share[a] * (1 - t), item.share[b] * t]
        order = np.argsort(-np.abs(both[1]), axis=1, kind="stable")[:, :width]
        chosen = np.take_along_axis(both[1], order, 1)
        follow.append(np.take_along_axis(both[0], order, 1).astype(np.int32))
        share.append(chosen / chosen.sum(1, keepdims=True))
    used, local = np.unique(np.array(faces, np.int64), return_inverse=True)
    table, f = rows[0][used], np.float32
    return Item(
        item.name, table[:, :3].astype(f), np.concatenate(follow)[used], np.concatenate(share)[used].astype(f),
        table[:, 3:5].astype(f), local.reshape(-1, 3).astype(np.int32), item.picture,
    )  # fmt: skip
