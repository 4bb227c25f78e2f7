"""Light by seed: surroundings, lamps with shadows, and how much of the surroundings each vertex sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from models.lightstage.light.prior import sample_scene
from models.lightstage.skin.streams import Stream
from models.people.draw import Mesh, lamp_matrix
from models.people.shaders import MOST_LAMPS
from service.light.environment import flux_by_direction, illumination, spread_directions

Float = npt.NDArray[np.float32]
Array = npt.NDArray[np.float64]

DIRECTIONS = 18
"""Directions that stand for the surroundings."""
AMBIENT_SIZE = 96
"""Side of the depth map of each, pixels."""
AMBIENT_RADIUS_M = 0.17
BIAS_M = 0.004
FARTHEST_M = 12.0
"""Lamps beyond are drawn from here, as bright."""
OCCLUDER_M = 0.07
"""Distance of what casts a shadow from where it falls, about: a wide lamp's penumbra is its share of this."""


@dataclass(frozen=True)
class Light:
    """Everything that lights a portrait.

    Attributes:
        sky: (64, 128, 3) float32 radiance, latitude-longitude, without what became a lamp.
        at: (L, 3) metres; power: (L, 3) intensity, radiance units times square metres; size: (L,) metres across.
        gobo: (128, 128) uint8 what the first lamp's light passes through; gobo_share: in [0, 1].
    """

    sky: Float
    at: Array
    power: Array
    size: Array
    gobo: npt.NDArray[np.uint8]
    gobo_share: float

    def uniforms(self) -> dict[str, object]:
        """What the shaders want to know of the lamps."""
        at, power, size = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
        n = len(self.at)
        at[:n], power[:n] = self.at, self.power
        distance = np.linalg.norm(self.at, axis=1)
        size[:n] = np.clip(self.size * OCCLUDER_M / np.maximum(distance, 0.1) / 0.48, 0.0015, 0.06)
        matrices = np.stack([*self.matrices(), *([np.eye(4)] * (3 - n))])
        return {
            "lamps": n, "lampAt": [tuple(x) for x in at], "lampLight": [tuple(x) for x in power],
            "lampSize": [float(x) for x in size],
            "toLamp": np.ascontiguousarray(matrices.transpose(0, 2, 1)).ravel(), "goboShare": self.gobo_share,
        }  # fmt: skip

    def level(self) -> float:
        """Radiance of a surface of albedo 0.4 that faces forward, about."""
        lamps = (self.power.mean(1) / np.maximum((self.at**2).sum(1), 1e-4)).sum() if len(self.at) else 0.0
        return float(0.4 * (float(self.sky.mean()) + 0.5 * lamps / np.pi))

    def matrices(self) -> list[Array]:
        """Clip matrices of the lamps."""
        return [lamp_matrix(at) for at in self.at]


def draw_light(seed: int) -> Light:
    """The light named ``seed``."""
    s = Stream(seed, "light")
    found = illumination(sample_scene(seed))
    lamps = sorted(found.lights, key=lambda lamp: -sum(lamp.intensity) / sum(c * c for c in lamp.position_m))[
        :MOST_LAMPS
    ]
    kind = s.one()
    dim = 1.0 if kind < 0.5 else s.one(0.1, 0.6) if kind < 0.85 else s.one(0.02, 0.15)
    if kind > 0.75:
        lamps = lamps[:1]
    at, power, size = np.zeros((len(lamps), 3)), np.zeros((len(lamps), 3)), np.zeros(len(lamps))
    for k, lamp in enumerate(lamps):
        place = np.asarray(lamp.position_m, float)
        distance = float(np.linalg.norm(place))
        near = min(distance, FARTHEST_M)
        at[k], power[k] = place * near / distance, np.asarray(lamp.intensity) * (near / distance) ** 2
        size[k] = 2.0 * lamp.radius_m * near / distance
    share = s.one(0.5, 1.0) if s.chance(0.15) else 0.0
    return Light(np.asarray(found.sky * dim, np.float32), at, power, size, draw_gobo(s), share)


def draw_gobo(s: Stream, side: int = 128) -> npt.NDArray[np.uint8]:
    """(side, side) uint8: blinds, a window's bars or leaves, to be cast on a face."""
    y, x = np.mgrid[:side, :side] / side
    turn = s.one(0.0, np.pi)
    along = x * np.cos(turn) + y * np.sin(turn)
    across = y * np.cos(turn) - x * np.sin(turn)
    kind = s.one()
    if kind < 0.3:
        image = np.cos(2 * np.pi * s.one(4, 14) * along + s.one(0, 6))
    elif kind < 0.5:
        image = np.minimum(np.cos(2 * np.pi * s.one(2, 5) * along), np.cos(2 * np.pi * s.one(2, 5) * across)) + 0.6
    else:
        image = np.zeros_like(x)
        for _ in range(24):
            f = s.normal(0.0, s.one(10.0, 40.0), 2)
            image = image + np.cos(f[0] * x + f[1] * y + s.one(0, 6.3)) * 0.3
        image = image + s.one(-0.6, 0.6)
    sharp = s.one(1.0, 8.0)
    return np.asarray(255.0 / (1.0 + np.exp(-np.clip(4.0 * sharp * image, -30, 30))), np.uint8)


def ambient_matrices() -> Array:
    """(DIRECTIONS, 4, 4) orthographic clip matrices that look at the head from each direction."""
    out = []
    middle = np.array([0.0, -0.04, -0.06])
    for d in spread_directions(DIRECTIONS):
        side = np.cross(-d, [0.0, 1.0, 0.0])
        side /= np.linalg.norm(side)
        view = np.stack([side, np.cross(side, -d), -d])
        matrix = np.eye(4)
        matrix[:3, :3] = view / np.array([[AMBIENT_RADIUS_M], [AMBIENT_RADIUS_M], [2 * AMBIENT_RADIUS_M]])
        matrix[:3, 3] = -matrix[:3, :3] @ middle
        out.append(matrix)
    return np.array(out)


def add_ambient(meshes: list[Mesh], depth: Float, light: Light) -> None:
    """Give all meshes their irradiance from the sky, shadowed by what ``depth`` (N, s, s) sees from each direction."""
    flux = flux_by_direction(light.sky, DIRECTIONS).astype(np.float32)
    towards = spread_directions(DIRECTIONS).astype(np.float32)
    matrices = ambient_matrices().astype(np.float32)
    size = depth.shape[1]
    points = np.concatenate([m.position for m in meshes])
    normals = np.concatenate([m.normal for m in meshes])
    thin = np.concatenate([np.full(len(m.position), m.kind in ("hair", "cloth", "fur", "lens")) for m in meshes])
    total = np.zeros((len(points), 3), np.float32)
    seen = np.zeros(len(points), np.float32)
    whole = np.zeros(len(points), np.float32)
    bias = np.float32(BIAS_M / (2 * AMBIENT_RADIUS_M) * 0.5)
    for k in range(DIRECTIONS):
        clip = (points + np.float32(BIAS_M) * normals) @ matrices[k, :3, :3].T + matrices[k, :3, 3]
        column = np.clip(((clip[:, 0] * 0.5 + 0.5) * size), 0, size - 1).astype(np.int32)
        row = np.clip(((clip[:, 1] * 0.5 + 0.5) * size), 0, size - 1).astype(np.int32)
        inside = (np.abs(clip[:, 0]) < 1) & (np.abs(clip[:, 1]) < 1)
        z = clip[:, 2] * 0.5 + 0.5
        open_ = np.where(inside, np.clip((depth[k, row, column] + bias - z) / bias + 0.5, 0.0, 1.0), 1.0)
        cosine = normals @ towards[k]
        cosine = np.where(thin, np.abs(cosine) * 0.6 + 0.2, np.maximum(cosine, 0.0))
        total += (cosine * open_)[:, None] * flux[k]
        seen += cosine * open_
        whole += cosine
    share = seen / np.maximum(whole, 1e-6)
    # Light that other skin sends back; without it mouths and sockets are black.
    bounce = (1.0 - share)[:, None] * flux.sum(0) * 0.25 * 0.15
    values = np.concatenate([(total + bounce) / np.float32(np.pi), share[:, None]], 1).astype(np.float32)
    start = 0
    for m in meshes:
        m.ambient = values[start : start + len(m.position)]
        start += len(m.position)
