"""Glasses by rule: rims of several shapes, bridge, temples to the ears, and lenses that mirror."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from models.lightstage.skin.streams import Stream
from models.people.draw import Mesh
from models.people.figure import layouts, smooth_normals
from models.people.person import the_head
from service.face.reading import part_labels as labels

Float = npt.NDArray[np.float32]
Array = npt.NDArray[np.float64]

AROUND = 32
"""Points of a rim."""
VERTEX_DISTANCE_M = 0.012
"""From cornea to lens, as opticians fit them."""
CLEARANCE_M = 0.0015
"""Least distance of the frame from the skin."""


def tube(
    path: Array, radius: float, closed: bool, sides: int = 6, flat: float = 1.0
) -> tuple[Float, npt.NDArray[np.int32]]:
    """Vertices and triangles of a tube along (N, 3) points; ``flat`` stretches its section along the y axis."""
    ahead = np.roll(path, -1, 0) - np.roll(path, 1, 0)
    if not closed:
        ahead[0], ahead[-1] = path[1] - path[0], path[-1] - path[-2]
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    up = np.array([0.0, 0.9, 0.3])
    one = np.cross(ahead, up)
    one /= np.maximum(np.linalg.norm(one, axis=1, keepdims=True), 1e-6)
    two = np.cross(one, ahead)
    turn = 2 * np.pi * np.arange(sides) / sides
    ring = np.cos(turn)[None, :, None] * one[:, None] + np.sin(turn)[None, :, None] * two[:, None]
    ring[..., 1] *= flat
    points = (path[:, None] + radius * ring).reshape(-1, 3)
    n = len(path)
    i, k = np.meshgrid(np.arange(n if closed else n - 1), np.arange(sides), indexing="ij")
    a, b = i * sides + k, i * sides + (k + 1) % sides
    c, d = (i + 1) % n * sides + (k + 1) % sides, (i + 1) % n * sides + k
    triangles = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return points.astype(np.float32), triangles.astype(np.int32)


def merged(parts: list[tuple[Float, npt.NDArray[np.int32]]]) -> tuple[Float, npt.NDArray[np.int32]]:
    """Several meshes as one."""
    start, points, triangles = 0, [], []
    for p, t in parts:
        points.append(p)
        triangles.append(t + start)
        start += len(p)
    return np.concatenate(points), np.concatenate(triangles).astype(np.int32)


def _outline(s: Stream) -> Array:
    """(AROUND, 2) outline of the left lens about its middle, metres; x away from the nose."""
    turn = 2 * np.pi * np.arange(AROUND) / AROUND
    half, high, power = s.one(0.021, 0.029), s.one(0.014, 0.025), float(np.exp(s.one(np.log(2.0), np.log(7.0))))
    c, q = np.cos(turn), np.sin(turn)
    x = half * np.sign(c) * np.abs(c) ** (2 / power)
    y = high * np.sign(q) * np.abs(q) ** (2 / power)
    kind = s.one()
    if kind < 0.25:  # aviator: drops outwards
        y = y - 0.25 * np.clip(-y, 0, None) * (x / half) - 0.1 * high
    elif kind < 0.45:  # cat's eye: rises outwards
        y = y + 0.35 * high * np.clip(x / half, 0, 1) ** 2
    return np.stack([x, y], 1)


def glasses(seed: int, vertices: Float, light_level: float) -> list[Mesh]:
    """Meshes of a pair of glasses on a head.

    Args:
        seed: names the pair.
        vertices: (V, 3) metres with the expression.
        light_level: radiance of skin in this light, about; a reflection brighter than half of it hides what is behind.
    """
    s, head = Stream(seed, "glasses"), the_head()
    balls = [
        vertices[np.unique(head.triangles[head.triangle_part == head.part_names.index(n)])]
        for n in ("eye_left", "eye_right")
    ]
    eyes = np.array([0.5 * (b.min(0) + b.max(0)) for b in balls])
    front = max(float(b[:, 2].max()) for b in balls)
    middle, half = eyes.mean(0), 0.5 * float(eyes[0, 0] - eyes[1, 0])
    outline = _outline(s)
    width = float(outline[:, 0].max())
    centre = max(half + s.one(-0.001, 0.003), width + s.one(0.006, 0.010))
    drop, tilt, wrap = s.one(-0.006, 0.001), s.one(0.0, 0.2), s.one(0.5, 4.0)

    def bent(x: Array, y: Array) -> Array:
        z = front + VERTEX_DISTANCE_M + tilt * y - wrap * x * x
        return np.stack([middle[0] + x, middle[1] + drop + y, z], -1)

    rims = [bent(sign * (centre + outline[:, 0]), outline[:, 1]) for sign in (1.0, -1.0)]
    inner = centre - width
    bow = np.linspace(-1, 1, 9)
    height = s.one(0.1, 0.6) * float(outline[:, 1].max())
    bridge = bent(bow * (inner + 0.002), height + 0.003 * (1 - bow**2))
    bridge[:, 2] += 0.004 * (1 - bow**2)
    shift = _clearance(vertices, np.concatenate([*rims, bridge]))
    for path in (*rims, bridge):
        path[:, 2] += shift
    thick = s.one(0.0007, 0.0028)
    rimless, half_rim = s.chance(0.12), s.chance(0.15)
    parts = []
    for rim in rims:
        if half_rim:
            upper = rim[np.argsort(-rim[:, 1])[: AROUND // 2 + 1]]
            parts.append(tube(upper[np.argsort(upper[:, 0])], thick, False))
        elif not rimless:
            parts.append(tube(rim, thick, True))
    parts.append(tube(bridge, max(thick * 0.8, 0.0008), False))
    for sign, rim in zip((1.0, -1.0), rims, strict=True):
        parts.append(tube(_temple(vertices, rim, sign, height), max(0.8 * thick, 0.0009), False, flat=s.one(1.0, 2.2)))
    points, triangles = merged(parts)
    colour = np.array([0.01, 0.01, 0.01]) if s.chance(0.4) else s.uniform(0.01, 0.5, 3) ** 1.5
    if s.chance(0.3):
        colour = np.array([0.5, 0.42, 0.3]) * s.one(0.5, 1.2)
    frame = Mesh(
        "plain",
        points,
        smooth_normals(points, triangles),
        triangles,
        np.zeros((len(points), 4), np.float32),
        labels.GLASSES,
        uniforms={"colour": tuple(float(c) for c in colour), "gloss": (0.12, 0.3, 0.7, 1.5)},
    )
    return [frame, _lenses(s, rims, light_level)]


def _clearance(vertices: Float, points: Array) -> float:
    """How far forward the frame has to move to leave the skin."""
    skin = vertices[layouts()["skin"].source]
    skin = skin[skin[:, 2] > 0.0]
    index = cKDTree(skin[:, :2]).query(points[:, :2], 4)[1]
    return float(np.clip((skin[index, 2].max(1) - points[:, 2]).max() + CLEARANCE_M, -0.004, 0.018))


def _temple(vertices: Float, rim: Array, sign: float, height: float) -> Array:
    """(N, 3) path from the rim over the ear."""
    head = the_head()
    ear = vertices[head.region("ear_left" if sign > 0 else "ear_right") > 0.5]
    hinge = rim[np.argmax(sign * rim[:, 0])] + [sign * 0.002, 0.3 * height, -0.001]
    over = np.array(
        [sign * np.quantile(sign * ear[:, 0], 0.25), np.quantile(ear[:, 1], 0.85), np.quantile(ear[:, 2], 0.45)]
    )
    t = np.linspace(0.0, 1.0, 10)[:, None]
    path = hinge + (over - hinge) * t
    skin = vertices[layouts()["skin"].source]
    side = skin[(sign * skin[:, 0] > 0.03)]
    index = cKDTree(side[:, 1:]).query(path[:, 1:], 6)[1]
    wide = (sign * side[index, 0]).max(1) + 0.001
    ears = np.linspace(0, 1, 10) > 0.8  # there the temple runs between ear and head
    path[:, 0] = np.where(ears, path[:, 0], sign * np.maximum(sign * path[:, 0], wide))
    down = np.array([[0.0, -0.012, -0.018], [0.0, -0.03, -0.026]])
    return np.concatenate([path, over + down])


def _lenses(s: Stream, rims: list[Array], light_level: float) -> Mesh:
    parts, normals, curve = [], [], s.one(1.5, 8.0)
    for rim in rims:
        middle = rim.mean(0)
        steps = np.linspace(0.02, 1.0, 6)
        points = np.concatenate([middle + k * (rim - middle) for k in steps])
        n = len(rim)
        i, k = np.meshgrid(np.arange(n), np.arange(len(steps) - 1), indexing="ij")
        a, b = k * n + i, k * n + (i + 1) % n
        triangles = np.concatenate(
            [np.stack([a, b, b + n], -1).reshape(-1, 3), np.stack([a, b + n, a + n], -1).reshape(-1, 3)]
        )
        across = points - middle
        normal = np.stack([curve * across[:, 0] + 2.0 * middle[0], curve * across[:, 1], np.ones(len(points))], 1)
        parts.append((points.astype(np.float32), triangles.astype(np.int32)))
        normals.append(normal / np.linalg.norm(normal, axis=1, keepdims=True))
    points32, triangles32 = merged(parts)
    kind = s.one()
    transmission = 0.96 if kind < 0.7 else s.one(0.35, 0.8) if kind < 0.8 else s.one(0.02, 0.25)
    mirror = s.one(0.04, 0.09) if kind < 0.9 else s.one(0.15, 0.6)
    coat = tuple(float(x) for x in (np.ones(3) if s.chance(0.5) else s.uniform(0.4, 1.0, 3)))
    return Mesh(
        "lens",
        points32,
        np.concatenate(normals).astype(np.float32),
        triangles32,
        np.zeros((len(points32), 4), np.float32),
        labels.GLASSES,
        shadows=transmission < 0.3,
        uniforms={"transmission": transmission, "tone": (*coat, mirror), "glare": 0.5 * light_level},
    )
