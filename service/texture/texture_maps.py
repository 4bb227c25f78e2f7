"""Result of the texture stage, and in it the head's shape: normals in object and tangent space, and depth."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from service.arrays import AnyFloat, Bool, Float32, Float64, UInt8
from service.geometry.chart import Chart
from service.geometry.mesh_field import laplacian, smooth_fit
from service.geometry.normals import normalise, vertex_normals


@dataclass(frozen=True)
class PhotoTexture:
    """What one of several photos shows, on the chart of the texture.

    Attributes:
        texture: (H, W, 3) uint8 sRGB in this photo's light; what it does not show is as the others do.
        lit_skin: (H, W) uint8, 255 where it shows skin on which the light can be measured.
        seen: (H, W) uint8, 255 where it shows the head's own surface.
        share: (H, W) uint8, 255 where the texture is this photo's alone.
        gain: (H, W, 3) float32, natural logarithm of linear RGB: of the texture's light over this photo's.
    """

    texture: UInt8
    lit_skin: UInt8
    seen: UInt8
    share: UInt8
    gain: Float32


@dataclass(frozen=True)
class Texture:
    """Maps of the fitted head on its chart, (H, W) texels, row 0 = top (v = 1). All texels are filled, also outside the
    islands.

    Attributes:
        texture: (H, W, 3) uint8 sRGB, the photo's light baked in.
        confidence: (H, W) uint8: ``SEEN`` to 255 seen in the photo, ``MIRRORED`` to ``SEEN - 1`` mirrored from the
            other side, each by weight; 0 inpainted.
        lit_skin: (H, W) uint8, 255 where the texel is skin of the photo, seen or mirrored, so that the light can be
            measured on it; 0 where it is hair, glasses, background or inpainted.
        shape_normal_object: (H, W, 3) float32 unit normals of the head with the photo's expression, in head space.
        shape_normal_tangent: (H, W, 3) float32 unit, z > 0, +Y up: the same normals in the tangent frame of the
            smoothed head (``service.texture.texture_maps``): they show nose and lips, but not the overall form of the
            head.
        depth: (H, W) float32 metres: z of the surface in head space, which grows towards the front of the face.
        mask: (H, W) bool, True inside the islands.
        visible_fraction: share of the face region's area that the photo shows, in [0, 1].
        warnings: stable codes: ``little-seen`` when less than a quarter of the face is visible, ``glasses-removed``
            when the skin under glasses was inpainted, ``face-covered`` when a hat, a mask, a hand or so hides over
            a fifth of the face, ``not-segmented`` when no part was read off the photo.
        parts: (H, W, 3) uint8 sRGB-coded diffuse albedo of eyes, eye sockets, teeth, tongue, mouth lining and lashes,
            extended over the chart; None for an external texture.
        iris, tooth: (3,) float32 linear RGB >= 0, albedo of irises and teeth; None for an external texture.
        roots: (H, W, 3) uint8, linear, 255 = 1: what the shadow of hair roots leaves of the skin albedo; None: it has
            none, or the hair stays on the skin.
        photos: what each of several photos shows, in the order of their fits; empty for one photo.
    """

    texture: UInt8
    confidence: UInt8
    lit_skin: UInt8
    shape_normal_object: Float32
    shape_normal_tangent: Float32
    depth: Float32
    mask: Bool
    visible_fraction: float
    warnings: tuple[str, ...] = field(default=())
    parts: UInt8 | None = None
    iris: Float32 | None = None
    tooth: Float32 | None = None
    roots: UInt8 | None = None
    photos: tuple[PhotoTexture, ...] = ()


OVERALL_SMOOTHNESS = 12.0
"""Weight of the smoothness term that turns the head's normals into those of its overall form."""

LEAST_Z = 0.05
"""Smallest z of a tangent-space normal before normalisation. In folds (ears, lids) the surface can be turned by more
than a right angle from the overall form, which a tangent-space map cannot represent."""


def shape_normals(chart: Chart, vertices: AnyFloat) -> tuple[Float32, Float32]:
    """Unit normals (H, W, 3) float32 of a head (V, 3) in object space, and in the tangent space of its overall form.

    In the tangent frame of the surface itself, a smooth surface's normals are (0, 0, 1) everywhere. The frame is
    therefore that of normals smoothed over the mesh (``OVERALL_SMOOTHNESS``), so that the map shows nose, lips and
    eye sockets: +Y up, z >= ``LEAST_Z`` before normalisation.
    """
    normal = vertex_normals(vertices, chart.head.triangles)
    frame = chart.frame(vertices, overall_normals(chart, normal))
    exact = chart.normals(vertices)
    axes = (frame.tangent, frame.bitangent, frame.normal)
    local = np.stack([np.einsum("hwi,hwi->hw", exact, axis) for axis in axes], -1)
    local[..., 2] = np.maximum(local[..., 2], LEAST_Z)
    local /= np.sqrt(np.einsum("hwi,hwi->hw", local, local))[..., None]
    return chart.fill_outside(exact), chart.fill_outside(local)


def overall_normals(chart: Chart, normal: AnyFloat) -> Float64:
    """(V, 3) unit normals smoothed over the mesh; where opposite ones cancel, the original."""
    edges = laplacian(chart.head.triangles, len(normal))
    smooth = smooth_fit(edges, normal, np.ones(len(normal)), OVERALL_SMOOTHNESS, np.zeros(3), 1e-6)
    length = np.sqrt((smooth * smooth).sum(1, keepdims=True))
    return np.where(length > 0.05, normalise(smooth), normal)


def depth_map(chart: Chart, vertices: AnyFloat) -> Float32:
    """(H, W) float32 metres: z of each texel in head space, extended beyond the islands."""
    depth = chart.interpolate(np.asarray(vertices)[:, 2])[..., 0]
    return chart.fill_outside(depth)
