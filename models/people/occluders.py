"""Things before the face: hands, and flat shapes with any texture, in focus or not."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from models.lightstage.skin.streams import Stream
from models.people.develop import clutter
from models.people.draw import Mesh
from models.people.figure import smooth_normals
from service.anatomy.items import Items
from service.face.reading import part_labels as labels

Float = npt.NDArray[np.float32]
Truth = dict[str, npt.NDArray[Any]]

TARGETS = (
    (0.0, -0.085, 0.035),
    (0.045, -0.05, 0.02),
    (0.03, 0.0, 0.02),
    (0.0, -0.06, 0.045),
    (0.0, 0.05, 0.035),
    (0.06, -0.08, 0.0),
    (0.065, -0.01, -0.01),
)
"""Where hands go, head space (left side): chin, cheek, eye, mouth, forehead, jaw, temple."""


def hand(seed: int, wardrobe: Items, colour: Float) -> Mesh:
    """A hand that covers a part of the face, bent about it; its arm reaches away."""
    s = Stream(seed, "hand")
    item = wardrobe.items["hand/left"]
    points = item.rest.astype(np.float64)
    tips = points[points[:, 0] > np.quantile(points[:, 0], 0.6)]
    middle = tips.mean(0)
    axes = np.linalg.svd(tips - middle, full_matrices=False)[2]
    along = axes[0] * np.sign(axes[0, 0])
    palm = axes[2] * (-1.0 if axes[2, 1] > 0 else 1.0)
    local = (points - middle) @ np.stack([along, np.cross(palm, along), palm]).T
    radius = s.one(0.06, 0.25)  # bent about the face
    angle = np.clip(local[:, 0], 0.0, None) / radius
    reach = radius - local[:, 2]
    bent = np.stack(
        [
            np.where(local[:, 0] > 0, reach * np.sin(angle), local[:, 0]),
            local[:, 1],
            np.where(local[:, 0] > 0, radius - reach * np.cos(angle), local[:, 2]),
        ],
        1,
    )
    side = 1.0 if s.chance(0.5) else -1.0
    target = np.array(TARGETS[int(s.one() * len(TARGETS))]) + s.normal(0.0, 0.012, 3)
    outward = target - np.array([0.0, -0.03, -0.08])
    outward /= np.linalg.norm(outward)
    roll = s.one(-2.2, 0.7)
    up = np.array([0.0, 1.0, 0.0]) - outward[1] * outward
    up /= np.linalg.norm(up)
    across = np.cross(up, outward)
    direction = np.cos(roll) * up + np.sin(roll) * across
    frame = np.stack([direction, np.cross(-outward, direction), -outward])
    placed = bent @ frame + target + outward * s.one(0.018, 0.03)
    placed[:, 0] *= side
    triangles = item.triangles if side > 0 else item.triangles[:, [0, 2, 1]]
    out = placed.astype(np.float32)
    gloved = s.chance(0.15)
    shown = tuple(float(c) for c in (s.uniform(0.02, 0.6, 3) if gloved else colour))
    return Mesh(
        "plain",
        out,
        smooth_normals(out, triangles),
        np.ascontiguousarray(triangles),
        np.zeros((len(out), 4), np.float32),
        labels.OTHER,
        uniforms={"colour": shown, "gloss": (0.35, 0.5, 0.7, 0.6)},
    )


def _blob(s: Stream, size: int, soft: float) -> Float:
    """(size, size) cover in [0, 1] of a random shape: polygon, ellipse, bar or fine lines."""
    image = np.zeros((size, size), np.float32)
    at = s.uniform(0.1, 0.9, 2) * size
    kind = s.one()
    if kind < 0.45:
        n = 3 + int(s.one() * 8)
        turn = np.sort(s.uniform(0, 2 * np.pi, n))
        radius = s.uniform(0.05, 0.32, n) * size
        points = at + np.stack([np.cos(turn), np.sin(turn)], 1) * radius[:, None]
        cv2.fillPoly(image, [points.astype(np.int32)], 1.0)
    elif kind < 0.65:
        axes = (s.uniform(0.04, 0.28, 2) * size).astype(int)
        cv2.ellipse(image, (int(at[0]), int(at[1])), (int(axes[0]), int(axes[1])), s.one(0, 180), 0, 360, 1.0, -1)
    elif kind < 0.8:
        end = s.uniform(-0.2, 1.2, 2) * size
        cv2.line(
            image, (int(at[0]), int(at[1])), (int(end[0]), int(end[1])), 1.0, max(2, int(s.one(0.02, 0.14) * size))
        )
    else:
        for _ in range(3 + int(s.one() * 25)):
            path = np.cumsum(s.normal(0.0, 0.06 * size, 12).reshape(6, 2), 0) + s.uniform(0, 1, 2) * size
            cv2.polylines(image, [path.astype(np.int32)], False, 1.0, 1 if s.chance(0.7) else 2, cv2.LINE_AA)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), soft) if soft > 0.2 else image, np.float32)


def screen(seed: int) -> Callable[[Float, Truth], Float]:
    """A flat thing before the picture; it hides what is behind it, in the truth too."""

    def put(light: Float, truth: Truth) -> Float:
        s = Stream(seed, "screen")
        size = light.shape[0]
        cover = _blob(s, size, s.one(0.0, 0.008) * size)
        there = truth["part"] != labels.BACKGROUND
        level = float(np.median(light[there].mean(-1))) if there.any() else float(light.mean())
        thing = clutter(s, size) * np.exp(s.normal(0.0, 0.5, 3) * 0.6).astype(np.float32)
        if s.chance(0.35):
            thing = np.ones_like(thing) * s.uniform(0.05, 1.0, 3).astype(np.float32)
        thing = thing / max(float(thing.mean()), 1e-4) * np.float32(level * s.log_normal(0.8, 0.7)[0])
        hidden = cover > 0.5
        depth = np.asarray(truth["depth"], np.float32)
        nearest = float(depth[np.isfinite(depth)].min()) if np.isfinite(depth).any() else 1.0
        truth["part"] = np.where(hidden, np.uint8(labels.OTHER), truth["part"])
        truth["chart"] = np.where(hidden[..., None], np.float32(np.nan), truth["chart"])
        truth["normal"] = np.where(hidden[..., None], np.array([0, 0, -1], np.float32), truth["normal"])
        truth["depth"] = np.where(hidden, np.float32(0.9 * nearest), truth["depth"])
        return np.asarray(light + cover[..., None] * (thing - light), np.float32)

    return put


def shade(seed: int) -> Callable[[Float, Truth], Float]:
    """A soft-edged shadow painted on the picture; the truth stays."""

    def put(light: Float, truth: Truth) -> Float:
        s = Stream(seed, "shade")
        size = light.shape[0]
        cover = _blob(s, size, s.one(0.003, 0.06) * size)
        depth = s.one(0.2, 0.9) * np.exp(s.normal(0.0, 0.05, 3)).astype(np.float32)
        return np.asarray(light * (1.0 - cover[..., None] * np.clip(depth, 0, 0.95)), np.float32)

    return put
