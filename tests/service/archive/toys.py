"""A small head with everything that the writers have to get right: a cut chart, quads and triangles, several parts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from service.archive.avatar import Avatar, ModelCard, Similarity
from service.faces.face import Face
from service.fit.result import Fit
from service.geometry.camera import Camera
from service.head.model import HeadModel
from service.photo.photo import Photo

NAMES = ("jawOpen", "eyeBlinkLeft", "mouthSmileRight", "tongueOut")


def sphere(rings: int, sectors: int, radius: float, centre: tuple[float, float, float]) -> tuple[npt.NDArray, ...]:
    """Vertices, polygons, uv, polygon_uv of a sphere with its seam at the back and triangles at the poles."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)[1:-1]
    longitude = -np.pi + 2 * np.pi * np.arange(sectors) / sectors  # 0 looks along +z, the seam at -z
    lat, lon = np.meshgrid(latitude, longitude, indexing="ij")
    grid = np.stack([np.cos(lat) * np.sin(lon), np.sin(lat), np.cos(lat) * np.cos(lon)], -1).reshape(-1, 3)
    vertices = np.concatenate([grid, [[0, -1, 0], [0, 1, 0]]]) * radius + centre
    south, north = len(grid), len(grid) + 1

    u, v = np.meshgrid(np.arange(sectors + 1) / sectors, np.arange(1, rings) / rings)
    poles = [[(k + 0.5) / sectors, end] for end in (0.0, 1.0) for k in range(sectors)]
    uv = np.concatenate([np.stack([u, v], -1).reshape(-1, 2), poles])
    polygons, polygon_uv = [], []
    for ring in range(rings - 2):
        for k in range(sectors):
            nxt = (k + 1) % sectors
            row, above = ring * sectors, (ring + 1) * sectors
            polygons.append([row + k, row + nxt, above + nxt, above + k])
            row, above = ring * (sectors + 1), (ring + 1) * (sectors + 1)
            polygon_uv.append([row + k, row + k + 1, above + k + 1, above + k])
    last, last_uv, pole_uv = (rings - 2) * sectors, (rings - 2) * (sectors + 1), (rings - 1) * (sectors + 1)
    for k in range(sectors):
        nxt = (k + 1) % sectors
        polygons += [[nxt, k, south, -1], [last + k, last + nxt, north, -1]]
        polygon_uv += [[k + 1, k, pole_uv + k, -1], [last_uv + k, last_uv + k + 1, pole_uv + sectors + k, -1]]
    return vertices, np.array(polygons), uv, np.array(polygon_uv)


def toy_head(rings: int = 16, sectors: int = 24) -> HeadModel:
    """A ball of 9 cm with two eyes and a strip of lashes that shares the chart."""
    parts = [
        ("skin", sphere(rings, sectors, 0.09, (0.0, -0.03, -0.05))),
        ("eye_left", sphere(6, 8, 0.012, (0.031, 0.0, 0.03))),
        ("eye_right", sphere(6, 8, 0.012, (-0.031, 0.0, 0.03))),
        ("lashes", sphere(4, 6, 0.004, (0.0, 0.012, 0.045))),
    ]
    vertices, polygons, uv, polygon_uv, owner = [], [], [], [], []
    for index, (_, (points, faces, chart, faces_uv)) in enumerate(parts):
        base, base_uv = sum(map(len, vertices)), sum(map(len, uv))
        polygons.append(np.where(faces >= 0, faces + base, -1))
        polygon_uv.append(np.where(faces_uv >= 0, faces_uv + base_uv, -1))
        vertices.append(points)
        # The skin takes the upper nine tenths of the chart, the rest lies below it.
        uv.append(chart * (1.0, 0.9) + (0.0, 0.1) if index == 0 else chart * 0.08 + (0.1 * index, 0.01))
        owner += [index] * len(faces)
    mean = np.concatenate(vertices).astype(np.float32)
    quads, quads_uv, part = np.concatenate(polygons), np.concatenate(polygon_uv), np.array(owner, np.uint8)
    second = quads[:, 3] >= 0
    triangles = np.concatenate([quads[:, :3], quads[second][:, [0, 2, 3]]])
    triangles_uv = np.concatenate([quads_uv[:, :3], quads_uv[second][:, [0, 2, 3]]])
    rng = np.random.default_rng(3)
    expression = np.zeros((len(NAMES), len(mean), 3), np.float32)
    expression[0] = (mean[:, 1:2] < -0.04) * np.float32([0, -0.02, 0])  # dense on the skin
    expression[1, 40:52] = rng.normal(0, 0.002, (12, 3))  # sparse
    expression[2, 100:130] = rng.normal(0, 0.002, (30, 3))
    return HeadModel(
        name="toy", licence="CC0-1.0", mean=mean, identity=rng.normal(0, 1e-3, (2, *mean.shape)).astype(np.float32),
        expression=expression, expression_names=NAMES,
        polygons=quads.astype(np.int32), polygon_uv=quads_uv.astype(np.int32), polygon_part=part,
        part_names=tuple(name for name, _ in parts), uv=np.concatenate(uv).astype(np.float32),
        mirror=np.arange(len(mean), dtype=np.int32),
        triangles=triangles.astype(np.int32), triangle_uv=triangles_uv.astype(np.int32),
        triangle_part=np.concatenate([part, part[second]]),
        landmark_triangle=np.arange(468, dtype=np.int32), landmark_barycentric=np.full((468, 3), 1 / 3, np.float32),
        landmark_spread=np.full(468, 1e-3, np.float32), contour_landmarks=np.zeros(0, np.int32),
        contour_yaw_deg=np.zeros(1, np.float32), contour_triangle=np.zeros((1, 0), np.int32),
        contour_barycentric=np.zeros((1, 0, 3), np.float32), region_names=("face",),
        regions=np.ones((1, len(mean)), np.float32),
    )  # fmt: skip


@dataclass(frozen=True)
class ToyTexture:
    texture: npt.NDArray[np.uint8]
    confidence: npt.NDArray[np.uint8]
    shape_normal_object: npt.NDArray[np.float32]
    visible_fraction: float = 0.7
    warnings: tuple[str, ...] = ("mirrored",)


def toy_texture(width: int = 96, height: int = 64) -> ToyTexture:
    rng = np.random.default_rng(5)
    normals = rng.normal(0, 1, (height, width, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    confidence = np.repeat(np.uint8([[255], [128], [0], [64]]), height // 4, 0) * np.ones((1, width), np.uint8)
    return ToyTexture(rng.integers(0, 256, (height, width, 3), np.uint8), confidence, normals)


@dataclass
class ToyAvatar:
    """Makes avatars of the toy head, with any field replaced."""

    head: HeadModel = field(default_factory=toy_head)

    def __call__(self, **changes: object) -> Avatar:
        head = self.head
        turn = np.radians(20.0)
        about_y = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
        camera = Camera(
            320, 240, 500.0, np.array([161.0, 119.0]), np.diag([1.0, -1.0, -1.0]) @ about_y, np.array([0.01, -0.02, 0.6])
        )
        expression = np.array([0.5, 0.0, 0.25, 0.0])
        identity = np.array([0.4, -1.0])
        neutral = head.shape(identity)
        posed = head.shape(identity, expression)
        corners = posed[head.triangles[head.landmark_triangle]]
        marks = camera.project((corners * head.landmark_barycentric[..., None]).sum(1))
        face = Face(
            np.array([80.0, 40.0, 240.0, 200.0]), 0.9, np.zeros((6, 2)), np.column_stack([marks, np.zeros(468)]), 0.99
        )
        values = {
            "photo": Photo(np.random.default_rng(1).integers(0, 256, (240, 320, 3), np.uint8), None, "ab" * 32),
            "face": face,
            "head": head,
            "fit": Fit(camera, identity, expression, posed, neutral, np.ones((9, 3)), 1.5, 55.0, ("low-confidence",)),
            "texture": toy_texture(),
            "options": {"quality": "standard", "maps": ["texture"], "face": None},
            "seed": 7,
            "models": (ModelCard("toy", "cd" * 32, "CC0-1.0", "head model"),),
            "similarity": Similarity(0.4, 0.6, {"centred_cosine_mean": 0.0, "centred_cosine_p95": 0.3}),
        }
        return Avatar(**(values | changes))  # type: ignore[arg-type]
