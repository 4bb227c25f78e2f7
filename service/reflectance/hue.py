"""How red and how yellow skin can be.

Skin alone does not tell warm light from warm skin, nor a photo's saturation from either. But melanin and blood leave
little choice: as spectrophotometers find it, the reddest fair cheek has twice as much red as green, and only dark skin
has more. What a network finds beyond that is the light's or the camera's.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.colour import LUMA

Float = npt.NDArray[np.float32]

FAIR, DARK = float(np.log(0.25)), float(np.log(0.11))
"""Log luminance of the albedo from which on skin counts as fair, and down to which as dark; between them, between."""

REDDEST = (0.70, 1.1)
"""Log of red over green of linear albedo that hardly anyone's fair, dark skin exceeds: CIELAB a* of about 17 and 19."""

YELLOWEST = (0.50, 0.87)
"""The same of green over blue: b* of about 22 and 25."""

BEYOND = 0.2
"""What is left of an excess: redder findings stay redder than others."""

FEW = 50
"""Texels below which skin is not judged."""


def within_skin(light: Float, linear: Float, lit: Float) -> Float:
    """(3, h, w) log light with more red and less blue, so that the skin is no redder or yellower than skin can be.

    Only these two channels change: what is in excess was their light. Skin is judged by its median, so lips and brows
    do not matter.

    Args:
        light: (3, h, w) log light that was found.
        linear: (3, h, w) linear RGB texture.
        lit: (h, w) in [0, 1], where the light is to be believed.
    """
    log_albedo = np.log(np.maximum(linear, np.float32(1e-4))) - light
    chosen = log_albedo[:, lit > 0.5]
    if chosen.shape[1] < FEW:
        return light
    red, green, blue = (float(value) for value in np.median(chosen, 1))
    luminance = float(np.log(LUMA @ np.exp([red, green, blue])))
    share = float(np.clip((FAIR - luminance) / (FAIR - DARK), 0.0, 1.0))
    tint = [_excess(red - green, REDDEST, share), 0.0, -_excess(green - blue, YELLOWEST, share)]
    return np.asarray(light + np.array(tint, np.float32)[:, None, None], np.float32)


def _excess(found: float, limits: tuple[float, float], share: float) -> float:
    fair, dark = limits
    return (1.0 - BEYOND) * max(found - (fair + share * (dark - fair)), 0.0)
