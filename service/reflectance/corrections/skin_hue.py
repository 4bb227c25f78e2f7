"""How red and how yellow skin can be.

Skin alone does not tell warm light from warm skin, nor a photo's saturation from either. But melanin and blood leave
little choice: as spectrophotometers find it, the reddest fair cheek has twice as much red as green, and only dark skin
has more. What a network finds beyond that is the light's or the camera's.
"""

from __future__ import annotations

import numpy as np

from service.arrays import Float32
from service.colour import LUMA
from service.ledger import Constant
from service.reflectance.corrections.on_light import LightCorrection

FAIR, DARK = float(np.log(0.25)), float(np.log(0.11))
"""Log luminance of the albedo from which on skin counts as fair, and down to which as dark; between them, between."""

REDDEST = (0.70, 1.1)
"""Log of red over green of linear albedo that hardly anyone's fair, dark skin exceeds: CIELAB a* of about 17 and 19."""

YELLOWEST = (0.50, 0.87)
"""The same of green over blue: b* of about 22 and 25."""

BEYOND = 0.2
"""What is left of an excess: redder findings stay redder than others."""

FEW = 50
"""Fewest texels of lit skin by whose median the hue is told."""


def within_skin(light: Float32, linear: Float32, lit: Float32) -> Float32:
    """(3, h, w) log light with another tint, so that the skin is no redder or yellower than skin can be.

    Half of what the skin's luminance would lose with its red comes back: red that is in excess makes skin too bright,
    but the network also takes redder skin for darker skin. Skin is judged by its median, so lips and brows do not
    matter.

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
    tint = np.array([_excess(red - green, REDDEST, share), 0.0, -_excess(green - blue, YELLOWEST, share)])
    tint += 0.5 * (np.log(LUMA @ np.exp([red, green, blue] - tint)) - luminance)
    return np.asarray(light + tint.astype(np.float32)[:, None, None], np.float32)


def _excess(found: float, limits: tuple[float, float], share: float) -> float:
    fair, dark = limits
    return (1.0 - BEYOND) * max(found - (fair + share * (dark - fair)), 0.0)


SKIN_HUE = LightCorrection(
    name="skin-hue",
    mends="Warm light or a saturated photo leaves skin redder or yellower than skin is.",
    source="light",
    constants={
        "reddest": Constant(REDDEST, "log red over green, fair and dark skin", "spectrophotometry: a* 17, 19"),
        "yellowest": Constant(YELLOWEST, "log green over blue, fair and dark skin", "spectrophotometry: b* 22, 25"),
        "beyond": Constant(BEYOND, "share of an excess that stays", "chosen by eye"),
    },
    cases=("warm", "graded"),
    apply=lambda at: within_skin(at.light, at.texture, at.weight),
)
