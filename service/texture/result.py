"""What the texture stage hands on."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from service.ledger import Applied

SEEN = 128
"""Confidence of a texel of which the photo shows just a little; 255 where it shows it squarely and alone."""

MIRRORED = 1
"""Lowest confidence of a texel taken from the other side of the head; ``SEEN - 1`` where that side is seen squarely.

0 means made up: continued from the surroundings, or painted by the program.
"""


@dataclass(frozen=True)
class Texture:
    """Maps of the fitted head on its chart, (H, W) texels, row 0 = top (v = 1). All texels are filled, also outside.

    Attributes:
        texture: (H, W, 3) uint8 sRGB, the photo's light baked in.
        confidence: (H, W) uint8: 255 to ``SEEN`` seen in the photo, by weight; below that to ``MIRRORED`` mirrored from
            the other side; 0 made up.
        lit_skin: (H, W) uint8, 255 where the texel is skin as the photo shows it, seen or mirrored, so that its light
            can be read off it; 0 where it is hair, glasses, background or made up.
        shape_normal_object: (H, W, 3) float32 unit normals of the head with the photo's expression, in head space.
        shape_normal_tangent: (H, W, 3) float32 unit, z > 0, +Y up: the same normals in the frame of the smoothed head
            (``service.texture.shape``), so they show noses and lips but not the ball of the head.
        depth: (H, W) float32 metres: head-space z of the surface, the distance along the axis of an orthographic camera
            in front of the face, growing towards it.
        mask: (H, W) bool, True inside the islands.
        visible_fraction: share of the face region's area that the photo shows, in [0, 1].
        warnings: stable codes: ``little-seen`` when under a quarter of the face shows, ``glasses-removed`` when skin
            was made up in place of the frame of glasses, ``face-covered`` when something that is no skin, a cap or a
            mask, covers over a fifth of the face; it stays in the maps.
        worn: (H, W) uint8, 255 where the texture has the colour of that cap or mask, seen or made up; None: nowhere.
        parts: (H, W, 3) uint8 sRGB-coded diffuse albedo of eyes, teeth, tongue, lashes and what lies between lids and
            lips, continued over the chart; None for a texture of other origin.
        iris: (3,) float32 linear RGB >= 0, albedo of the irises; None for a texture of other origin.
        corrections: those that ran, in order, and what they changed.
    """

    texture: npt.NDArray[np.uint8]
    confidence: npt.NDArray[np.uint8]
    lit_skin: npt.NDArray[np.uint8]
    shape_normal_object: npt.NDArray[np.float32]
    shape_normal_tangent: npt.NDArray[np.float32]
    depth: npt.NDArray[np.float32]
    mask: npt.NDArray[np.bool_]
    visible_fraction: float
    warnings: tuple[str, ...] = field(default=())
    worn: npt.NDArray[np.uint8] | None = None
    parts: npt.NDArray[np.uint8] | None = None
    iris: npt.NDArray[np.float32] | None = None
    corrections: tuple[Applied, ...] = ()
