"""Avatars of the toy head."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from service.archive.avatar import Avatar
from service.face.finder import Face
from service.face.fit.fit import Fit
from service.geometry.camera import Camera
from service.head.model import HeadModel
from service.manifest import IdentitySimilarity, Integration, ModelEntry
from service.map_registry import MAP_NAMES
from service.materials.material import Material, OwnMap
from service.materials.part import MeshPart
from service.photo.photo import Photo
from service.reflectance.reflectance_maps import Reflectance, pack_normals
from service.reflectance.relief.displacement import encode_heights
from service.reflectance.surface_maps import surface_maps
from service.texture.texture import Texture
from tests.toyhead import sphere_head

REFLECTANCE_SIZE = (192, 128)


def toy_head() -> HeadModel:
    """The toy head with a unit that moves a few vertices only, and one that moves nothing."""
    head = sphere_head(16, 24)
    few = np.zeros_like(head.mean)
    few[40:52] = np.random.default_rng(3).normal(0, 0.002, (12, 3))
    expression = np.concatenate([head.expression, few[None], np.zeros_like(few)[None]])
    names = (*head.expression_names, "eyeBlinkLeft", "tongueOut")
    return replace(head, expression=expression.astype(np.float32), expression_names=names)


def toy_texture(width: int = 96, height: int = 64) -> Texture:
    rng = np.random.default_rng(5)
    normals = rng.normal(0, 1, (height, width, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    confidence = np.tile(np.repeat(np.array([255, 128, 0, 64], np.uint8), height // 4)[:, None], (1, width))
    colour = rng.integers(0, 256, (height, width, 3), np.uint8)
    mask = np.ones((height, width), bool)
    return Texture(colour, confidence, confidence, normals, mask, 0.7, ("little-seen",))


def toy_camera() -> Camera:
    turn = np.radians(20.0)
    about_y = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    rotation = np.diag([1.0, -1.0, -1.0]) @ about_y
    return Camera(320, 240, 500.0, np.array([161.0, 119.0]), rotation, np.array([0.01, -0.02, 0.6]))


def toy_avatar(**changes: Any) -> Avatar:
    """An avatar of the toy head, with any field replaced."""
    head, camera = toy_head(), toy_camera()
    expression, identity = np.array([0.5, 0.0, 0.25, 0.0]), np.array([0.4, -1.0])
    posed = head.shape(identity, expression)
    corners = posed[head.triangles[head.landmark_triangle]]
    marks = camera.project((corners * head.landmark_barycentric[..., None]).sum(1))
    box = np.array([80.0, 40.0, 240.0, 200.0])
    face = Face(box, 0.9, np.zeros((6, 2)), np.column_stack([marks, np.zeros(468)]), 0.99)
    light = np.ones((9, 3))
    fit = Fit(camera, identity, expression, posed, head.shape(identity), light, 1.5, 55.0, ("low-confidence",))
    values: dict[str, Any] = {
        "photo": Photo(np.random.default_rng(1).integers(0, 256, (240, 320, 3), np.uint8), None, "ab" * 32),
        "face": face,
        "head": head,
        "fit": fit,
        "texture": toy_texture(),
        "options": {"size": [96, 64], "maps": ["texture", "confidence", "shape_normal"], "face": None},
        "seed": 7,
        "models": (ModelEntry("toy sphere", "cd" * 32, "CC0-1.0", "head model"),),
        "similarity": IdentitySimilarity(0.4, 0.6, {"centred_cosine_mean": 0.0, "centred_cosine_p95": 0.3}),
        "timings_s": {"decode": 0.1},
    }
    return Avatar(**(values | changes))


def toy_part(**changes: Any) -> MeshPart:
    """Two cards with alpha before the forehead, a quad and a triangle, that follow the jaw; they replace the lashes."""
    rng = np.random.default_rng(9)
    corners = np.array([[-1, 0, 0], [1, 0, 0], [1, 1, 0], [-1, 1, 0], [0, 2, 0]], np.float32) * np.float32(0.02)
    neutral = corners + np.array([0, 0.03, 0.03], np.float32)
    jaw = np.array([0, -0.004, 0.001], np.float32) * np.ones((5, 1), np.float32)
    # MTL cannot say at which alpha to cut: a mask that has both extremes only, in large texels, looks alike uncut.
    pixels = np.kron(rng.integers(0, 256, (8, 8, 4), np.uint8), np.ones((8, 8, 1), np.uint8))
    pixels[..., 3] = np.where(pixels[..., 3] > 102, 255, 0)
    material = Material(
        "toy_hair", colour_map=OwnMap("toy_hair", pixels), alpha="mask", cutoff=0.4, double_sided=True, roughness=0.3,
        ior=1.55,
    )  # fmt: skip
    values: dict[str, Any] = {
        "name": "toy_hair",
        "vertices": neutral + np.float32(0.5) * jaw,
        "neutral": neutral,
        "faces": np.array([[0, 1, 2, 3], [3, 2, 4, -1]], np.int32),
        # Within the texture: on its border, where viewers repeat it, rounding would decide which end is seen.
        "uv": np.array([[0.1, 0.1], [0.9, 0.1], [0.9, 0.6], [0.1, 0.6], [0.5, 0.9]], np.float32),
        "material": material,
        "targets": {"jawOpen": jaw},
        "replaces": ("lashes",),
    }
    return MeshPart(**(values | changes))


def toy_reflectance() -> Reflectance:
    rng = np.random.default_rng(11)
    shape = REFLECTANCE_SIZE[::-1]
    x, y = rng.normal(0, 0.2, (2, *shape)).astype(np.float32)
    normals = pack_normals(x, y, np.ones_like(x))
    return Reflectance(
        size=REFLECTANCE_SIZE,
        diffuse_albedo=rng.integers(0, 65536, (*shape, 3), np.uint16),
        specular_albedo=rng.integers(0, 65536, shape, np.uint16),
        specular_normal=normals,
        diffuse_normal=normals[::-1].copy(),
        displacement=encode_heights(rng.normal(0, 0.05, shape).astype(np.float32)),
        tile=1024,
        super_resolution=True,
        integration=Integration(4, 0.001, 0.0),
    )


def whole_avatar() -> Avatar:
    """An avatar with all maps and a part beside the head's own."""
    made, options = toy_reflectance(), {"maps": list(MAP_NAMES), "quality": "standard", "normals": "tangent"}
    plain = toy_avatar()
    surface = surface_maps(plain.head, plain.fit.vertices, made, MAP_NAMES, REFLECTANCE_SIZE)
    return toy_avatar(options=options, reflectance=made, surface=surface, parts=(toy_part(),))
