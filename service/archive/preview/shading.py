"""Shading of previews: at the vertices, which lie a few pixels apart, and without cast shadows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, Bool, Float32
from service.geometry.normals import normalise
from service.head.model import HeadModel
from service.light.scene import Triple
from service.materials.of_head import material_of

CLAY = (0.50, 0.47, 0.44)
"""Linear albedo of the untextured skin."""
_PART_CLAY = {
    "eye": (0.72, 0.72, 0.72),
    "teeth": (0.68, 0.66, 0.60),
    "tongue": (0.42, 0.28, 0.26),
    "lashes": (0.26, 0.24, 0.22),
}

_NOWHERE = (0.0, 0.0, 0.0)
"""Unit vector where there is no direction: it receives no light."""

_WRAP = 0.25
"""Cosine by which light wraps around the terminator, which is soft under a large lamp."""
_GLOSS, _SHARPNESS = 0.05, 24
"""Strength and Blinn-Phong exponent of the highlight."""

_DARKEST = 0.82
"""Factor on coded colours of a texture at grazing angles; 1 where it faces the camera."""


@dataclass(frozen=True)
class Lamps:
    """Large distant lamps.

    Attributes:
        lamps: of each, the direction to it in camera axes (x right, y down, z away) and its linear RGB; the first one
            is the key light, which has a highlight.
        ambient: linear RGB from all directions.
    """

    lamps: tuple[tuple[Triple, Triple], ...]
    ambient: Triple

    def on(self, in_camera: AnyFloat, normals: AnyFloat, sheets: Bool) -> tuple[Float32, Float32]:
        """(V, 3) linear radiance of a white diffuse surface, and (V, 1) of the highlight.

        Args:
            in_camera: (V, 3) vertices, camera axes.
            normals: (V, 3) unit, camera axes.
            sheets: (V, 1) vertices of double-sided parts, which are shaded on both sides.
        """
        view = normalise(-in_camera, _NOWHERE)
        # Only double-sided parts show back faces. Elsewhere normals that face away lie at the silhouette; turned, they
        # would flash.
        facing = np.where(sheets & ((normals * view).sum(1, keepdims=True) < 0), -normals, normals)
        light = np.tile(np.array(self.ambient), (len(facing), 1))
        towards = normalise(np.array([direction for direction, _ in self.lamps]), _NOWHERE)
        for direction, (_, colour) in zip(towards, self.lamps, strict=True):
            light += np.clip((facing @ direction + _WRAP) / (1 + _WRAP), 0, 1)[:, None] ** 1.5 * np.array(colour)
        half = normalise(towards[0] + view, _NOWHERE)
        gloss = _GLOSS * np.clip((facing * half).sum(1, keepdims=True), 0, 1) ** _SHARPNESS
        return light.astype(np.float32), gloss.astype(np.float32)


STUDIO = Lamps(
    (
        ((-0.55, -0.60, -0.58), (0.86, 0.84, 0.80)),
        ((0.80, -0.15, -0.58), (0.16, 0.18, 0.22)),
        ((0.30, -0.45, 0.84), (0.30, 0.32, 0.36)),
    ),
    (0.15, 0.15, 0.17),
)
"""Key, fill and rim."""


def side_lamp(azimuth_deg: float) -> Lamps:
    """A strong lamp above eye level, ``azimuth_deg`` from the camera (> 0: at the image's right), and a dim sky."""
    angle = np.radians(azimuth_deg)
    key = (0.9 * float(np.sin(angle)), -0.45, -0.9 * float(np.cos(angle)))
    return Lamps(((key, (1.5, 1.46, 1.4)), ((0.0, -1.0, 0.3), (0.25, 0.27, 0.31))), (0.12, 0.125, 0.14))


def baked(in_camera: AnyFloat, normals: AnyFloat) -> Float32:
    """(V, 1) factor on the coded colours of a texture with baked-in light; arguments as :meth:`Lamps.on`."""
    cosine = (normals * normalise(-in_camera, _NOWHERE)).sum(1, keepdims=True)
    return np.asarray(_DARKEST + (1 - _DARKEST) * np.abs(cosine), np.float32)


def clay_colours(head: HeadModel) -> Float32:
    """(V, 3) linear albedo of each vertex by its part."""
    colours = np.tile(np.array(CLAY, np.float32), (len(head.mean), 1))
    for index, name in enumerate(head.part_names):
        colours[head.triangles[head.triangle_part == index]] = _PART_CLAY.get(material_of(name).name, CLAY)
    return colours


def sheets_of(head: HeadModel) -> Bool:
    """(V, 1) True for vertices of double-sided parts."""
    sheets = np.zeros((len(head.mean), 1), bool)
    sheets[head.triangles[double_sided(head)]] = True
    return sheets


def double_sided(head: HeadModel) -> Bool:
    """(T,) True for triangles of double-sided parts."""
    return np.array([material_of(name).double_sided for name in head.part_names])[head.triangle_part]
