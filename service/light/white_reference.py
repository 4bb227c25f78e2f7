"""White reference: the light of the photo, measured on sclera and teeth.

Skin alone cannot tell dark skin from dim light, nor brown skin from a warm lamp. Sclera and teeth are close to white in
everybody. Whatever is mistaken for them (lids, lips, lashes, shadow in the mouth) is redder, and so is sclera that is
lit by the skin around it alone, on the side away from a lamp. So the hue is taken from the least red measurements, and
the strength from all that are not lids.
"""

from __future__ import annotations

import numpy as np

from service.anatomy.eyes.gaze import Gaze
from service.anatomy.eyes.sclera import BETWEEN_LIDS, sclera_light
from service.anatomy.teeth.measure import teeth_light
from service.arrays import AnyFloat, Float32, Float64, UInt8
from service.colour import LUMA

CHEEKS = (50, 280)
"""Landmarks in the middle of the cheeks."""
CHEEK_RADIUS = 0.12
"""Radius of the sample on each cheek, over the inter-ocular distance."""
REDDER, SAME_HUE = 2.0, 1.3
"""Factors by which the ratio of blue to red may be below that of the least red measurement: to be sclera or tooth at
all (1.5 in the shade of a lamp from one side; lids have 1.4 to 2.5), and to contribute to the hue."""
RANGE = (1e-3, 4.0)
"""Range of linear radiance that an 8-bit photo can measure; results are clipped to it."""


def light_from_sclera_and_teeth(
    pixels: UInt8,
    gaze: Gaze | None,
    tooth: Float32 | None,
    skin: Float32 | None,
) -> Float64 | None:
    """Light between the lids, measured on the sclera and on the front teeth, which receive more of it.

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        gaze: with the detected irises.
        tooth: (3,) sRGB of the teeth; None where the photo shows none.
        skin: (3,) sRGB of the cheeks; None where the photo does not show them.

    Returns:
        (3,) linear RGB radiance of a white diffuse surface in place of the sclera, finite and positive: the geometric
        mean of the measurements in strength, the least red ones in hue. None where neither can be measured.
    """
    seen = [light for iris in (gaze.irises if gaze else ()) if (light := sclera_light(pixels, iris)) is not None]
    teeth = None if skin is None or tooth is None else teeth_light(tooth, skin)
    if teeth is not None:
        seen.append(teeth * BETWEEN_LIDS)
    return palest(np.stack(seen)) if seen else None


def palest(lights: Float64) -> Float64:
    """(3,) light from (N, 3) positive measurements, N > 0: strength of their geometric mean, hue of the least red."""
    pale = lights[:, 2] / lights[:, 0]
    logs = np.log(lights)
    hue, all_ = (logs[pale * redder >= pale.max()].mean(0) for redder in (SAME_HUE, REDDER))
    return np.asarray(np.clip(np.exp(hue) * (np.exp(all_) @ LUMA) / (np.exp(hue) @ LUMA), *RANGE), np.float64)


def cheek_colour(pixels: UInt8, landmarks: AnyFloat, inter_ocular_px: float) -> Float32 | None:
    """(3,) median sRGB colour in [0, 1] of the cheeks; None where the photo shows neither."""
    height, width = pixels.shape[:2]
    radius, found = CHEEK_RADIUS * inter_ocular_px, []
    for x, y in np.asarray(landmarks, np.float64)[list(CHEEKS), :2]:
        if not np.isfinite([x, y, radius]).all():
            continue
        left, top = (max(int(v - radius), 0) for v in (x, y))
        right, bottom = (min(int(np.ceil(v + radius)), most) for v, most in ((x, width), (y, height)))
        found.append(pixels[top : max(bottom, top), left : max(right, left)].reshape(-1, 3))
    colours = np.concatenate(found) if found else np.zeros((0, 3))
    return np.asarray(np.median(colours, 0) / 255, np.float32) if len(colours) else None
