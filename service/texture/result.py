"""Result of the texture stage."""

from __future__ import annotations

from dataclasses import dataclass, field

from service.arrays import Bool, Float32, UInt8

SEEN = 128
"""Lowest confidence of a texel seen in the photo; 255 where it is seen frontally, and the photo alone decides."""

MIRRORED = 1
"""Lowest confidence of a texel mirrored from the other side of the head; ``SEEN - 1`` where that side is seen
frontally.

0 means inpainted: continued from the surroundings, or painted synthetically.
"""


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
            smoothed head (``service.texture.shape``): they show nose and lips, but not the overall form of the head.
        depth: (H, W) float32 metres: z of the surface in head space, which grows towards the front of the face.
        mask: (H, W) bool, True inside the islands.
        visible_fraction: share of the face region's area that the photo shows, in [0, 1].
        warnings: stable codes: ``little-seen`` when less than a quarter of the face is visible, ``glasses-removed``
            when the skin under glasses was inpainted, ``face-covered`` when a hat, a mask, a hand or so hides over
            a fifth of the face, ``not-segmented`` when no part was read off the photo.
        parts: (H, W, 3) uint8 sRGB-coded diffuse albedo of eyes, eye sockets, teeth, tongue, mouth lining and lashes,
            extended over the chart; None for an external texture.
        iris: (3,) float32 linear RGB >= 0, albedo of the irises; None for an external texture.
        roots: (H, W, 3) uint8, linear, 255 = 1: what the shadow of hair roots leaves of the skin albedo; None: it has
            none, or the hair stays on the skin.
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
    roots: UInt8 | None = None
