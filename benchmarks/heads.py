"""Heads that our model has never seen, with skins that a face detector takes for people.

ICT-FaceKit gives the shapes (its identity basis comes from real scans); the textured head of FFHQ-UV gives the skin,
which is carried over by a thin-plate warp between the 468 landmarks of both and a search for the closest point.
Both are read from a folder that the caller names; nothing of them is part of this project.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from service.colour import linear_to_srgb, srgb_to_linear
from service.head.files import split_polygons

Float = npt.NDArray[np.float64]

CLIP_SIGMA = 2.0
EYE_RADIUS_M = 0.0121
EXPRESSIONS = ("jawOpen", "mouthSmile_L", "mouthSmile_R", "browInnerUp_L", "browInnerUp_R", "mouthPucker")


@dataclass(frozen=True)
class TexturedHead:
    """A head to be photographed.

    Attributes:
        name: for tables.
        vertices: (V, 3) metres, +Y up, +Z forward, origin between the eyes.
        triangles: (T, 3).
        colours: (V, 3) linear RGB albedo.
        eyes: (2, 3) eyeball centres, subject's left first.
        eye_radius: metres.
    """

    name: str
    vertices: Float
    triangles: npt.NDArray[np.int64]
    colours: Float
    eyes: Float
    eye_radius: float

    def colours_at(self, points: Float) -> tuple[Float, Float]:
        """Linear albedo (N, 3) at points (N, 3), a mean of the three nearest vertices'; metres to the nearest (N,)."""
        distance, index = cKDTree(self.vertices).query(points, k=3)
        weight = 1 / np.maximum(distance, 1e-6)
        return (self.colours[index] * weight[..., None]).sum(1) / weight.sum(1, keepdims=True), distance[:, 0]


class IctHeads:
    """Random heads of ICT-FaceKit in metres."""

    def __init__(self, path: Path) -> None:
        with np.load(path, allow_pickle=False) as data:
            self.neutral = data["neutral"].astype(np.float64) * 0.01
            self.identity = data["identity"].astype(np.float64) * 0.01
            self.expression = data["expression"].astype(np.float64) * 0.01
            self.names = [str(n) for n in data["expression_names"]]
            self.triangles = split_polygons(data["quads"]).astype(np.int64)
            self.landmarks = data["landmarks68"].astype(np.int64)
            self.lids = self.landmarks[36:48]

    def eyes_of(self, vertices: Float) -> Float:
        """(2, 3) eyeball centres: behind the lids, as deep as lets every lid vertex lie on or before the ball."""
        centres = []
        for lids in (self.lids[6:], self.lids[:6]):
            rim = vertices[lids]
            x, y = rim[:, :2].mean(0)
            flat = ((rim[:, :2] - (x, y)) ** 2).sum(1)
            depth = (rim[:, 2] - np.sqrt(np.maximum(EYE_RADIUS_M**2 - flat, 0.0))).min()
            centres.append([x, y, depth - 0.0002])
        return np.array(sorted(centres, key=lambda c: -c[0]))

    def sample(self, seed: int) -> tuple[Float, Float]:
        """(vertices centred between the eyes, eyeball centres); every third head has a mild expression."""
        rng = np.random.default_rng(seed)
        weights = np.clip(rng.normal(size=len(self.identity)), -CLIP_SIGMA, CLIP_SIGMA)
        vertices = self.neutral + np.tensordot(weights, self.identity, 1)
        if seed % 3 == 2:
            for name in rng.choice(EXPRESSIONS, 2, replace=False):
                vertices = vertices + rng.uniform(0.1, 0.4) * self.expression[self.names.index(str(name))]
        eyes = self.eyes_of(vertices)
        middle = eyes.mean(0)
        return vertices - middle, eyes - middle

    def posed(self, seed: int, expression: Mapping[str, float]) -> tuple[Float, Float]:
        """As :meth:`sample` of a neutral seed, with units of ``names`` by weight. The eyeballs stay where they are."""
        vertices, eyes = self.sample(seed)
        for name, weight in expression.items():
            vertices = vertices + weight * self.expression[self.names.index(name)]
        return vertices, eyes

    def textured(self, name: str, seed: int, colours: Float) -> TexturedHead:
        """A sample, subdivided, in its own tone of colours (V', 3) that lie on the subdivided mesh."""
        vertices, eyes = self.sample(seed)
        return TexturedHead(name, *subdivided(vertices, self.triangles, 2), varied(colours, seed), eyes, EYE_RADIUS_M)


@dataclass(frozen=True)
class Skin:
    """A textured reference head: the colours to be carried over.

    Attributes:
        vertices: (V, 3) in its own unit.
        triangles: (T, 3); uv: (V, 2) origin bottom left.
        texture: (H, W, 3) linear RGB.
    """

    vertices: Float
    triangles: npt.NDArray[np.int64]
    uv: Float
    texture: Float

    @classmethod
    def load(cls, folder: Path) -> Skin:
        """Read ``head.obj`` and ``texture.png`` of the FFHQ-UV head."""
        import cv2
        import trimesh

        mesh: Any = trimesh.load(folder / "head.obj", process=False)
        image = cv2.imread(str(folder / "texture.png"))
        if image is None:
            raise FileNotFoundError(folder / "texture.png")
        texture = srgb_to_linear(image[..., ::-1].astype(np.float32) / 255).astype(np.float64)
        return cls(np.asarray(mesh.vertices), np.asarray(mesh.faces), np.asarray(mesh.visual.uv), texture)

    def dense(self, rounds: int) -> tuple[Float, npt.NDArray[np.int64], Float]:
        """(vertices, triangles, linear colours) after midpoint subdivision in space and chart alike."""
        both = np.concatenate([self.vertices, self.uv], 1)
        fine, triangles = subdivided(both, self.triangles, rounds)
        return fine[:, :3], triangles, at_places(self.texture, fine[:, 3:])


def places_of(skin: Skin, side: int = 4096) -> Skin:
    """The same head with its chart's coordinates for colours: (u, v, 0) wherever it is sampled, to 1 / ``side``."""
    v, u = np.meshgrid(1 - (np.arange(side) + 0.5) / side, (np.arange(side) + 0.5) / side, indexing="ij")
    return replace(skin, texture=np.stack([u, v, np.zeros_like(u)], -1).astype(np.float32))


def at_places(texture: Float, places: Float) -> Float:
    """(N, 3) of a texture (H, W, 3) at coordinates (N, 2 or 3), origin bottom left: nearest texel."""
    height, width = texture.shape[:2]
    x = np.clip((places[:, 0] * width).astype(int), 0, width - 1)
    y = np.clip(((1 - places[:, 1]) * height).astype(int), 0, height - 1)
    return np.asarray(texture[y, x], np.float64)


def carry_skin(points: Float, from_landmarks: Float, skin: Skin, to_landmarks: Float) -> Float:
    """Colours for ``points`` (N, 3): warped so that landmarks (L, 3) meet those of the skin, then the closest vertex.

    Landmarks that are not finite in either set are left out.
    """
    from scipy.interpolate import RBFInterpolator

    good = np.isfinite(from_landmarks).all(1) & np.isfinite(to_landmarks).all(1)
    warp = RBFInterpolator(from_landmarks[good], to_landmarks[good], kernel="thin_plate_spline", smoothing=1e-6)
    vertices, _, colours = skin.dense(2)
    return np.asarray(colours[cKDTree(vertices).query(warp(points))[1]])


def varied(colours: Float, seed: int) -> Float:
    """Another person's tone: the same pattern, lighter or darker, redder or yellower."""
    rng = np.random.default_rng(1000 + seed)
    coded = linear_to_srgb(colours.astype(np.float32)).astype(np.float64)
    dark = rng.uniform(0.0, 1.0)
    gain = (1.05 - 0.65 * dark) * np.array([1.0, 1.0 - 0.10 * dark, 1.0 - 0.18 * dark])
    coded = coded * gain * rng.uniform(0.96, 1.04, 3)
    return np.asarray(srgb_to_linear(np.clip(coded, 0, 1).astype(np.float32)), np.float64)


def subdivided(values: Float, triangles: npt.NDArray[np.int64], rounds: int) -> tuple[Float, npt.NDArray[np.int64]]:
    """Midpoint subdivision of (V, C) values at the vertices, so that colours there have the detail of a texture."""
    for _ in range(rounds):
        sides = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
        unique, index = np.unique(sides, axis=0, return_inverse=True)
        ab, bc, ca = (len(values) + index.reshape(-1)).reshape(3, -1)
        a, b, c = triangles.T
        values = np.concatenate([values, values[unique].mean(1)])
        triangles = np.concatenate([np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return values, triangles
