"""How much of a photo's contrast from region to region is light: less than a network of even skins takes it for.

Where shade and pigment cannot be told apart, the best estimate divides the contrast between both by their variances
(Wiener). The light stage's skin varies less from region to region than real skin does, whose lids are darker than its
cheeks by a quarter to a half and whose cheeks and forehead are paler: so the network gives light too large a share.
Within two centimetres a share of what it found is light, and the rest is the skin's. The overall form of the light,
which is wider, stays.
"""

from __future__ import annotations

import numpy as np

from service.arrays import Float32
from service.ledger import Constant
from service.reflectance.corrections.on_light import LightCorrection

KEPT = 0.5
"""Share of the light's contrast that is light."""
WIDE = 14.0
"""Standard deviation of what counts as its overall form, texels of the context: 2 cm on the face."""
LEAST = 1e-3
"""Share of lit skin in the surroundings with less of which the light stays as it is."""


def less_contrast(light: Float32, lit: Float32, kept: float = KEPT, wide: float = WIDE) -> Float32:
    """(C, h, w) log light with a share of its local contrast where skin is lit; as it is far from all lit skin.

    Args:
        light: as it was found.
        lit: (h, w) in [0, 1], where it is to be believed.
        kept: share of the contrast, in [0, 1].
        wide: standard deviation of the surroundings, texels.
    """
    import cv2

    def blurred(plane: Float32) -> Float32:
        return np.asarray(cv2.GaussianBlur(np.asarray(plane, np.float32), (0, 0), wide), np.float32)

    near = blurred(lit)
    form = np.stack([blurred(plane * lit) for plane in light]) / np.maximum(near, np.float32(LEAST))
    return np.asarray(np.where(near > LEAST, form + np.float32(kept) * (light - form), light), np.float32)


LIGHT_CONTRAST = LightCorrection(
    name="light-contrast",
    mends="Regions of the skin that are darker or paler than the rest are taken for shade and light.",
    source="light",
    constants={
        "kept": Constant(KEPT, "share of the contrast", "docs/reflectance.md"),
        "wide": Constant(WIDE, "texels of the context, standard deviation", "docs/reflectance.md"),
    },
    cases=("soft", "hard"),
    apply=lambda at: less_contrast(at.light, at.weight),
)
