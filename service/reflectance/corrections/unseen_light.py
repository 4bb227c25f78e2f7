"""Light where the photo shows no skin: under hair and hats, and where the texture was inpainted.

The network has seen lit skin only, and would take other colours for brightly lit or shaded skin. There its light is
replaced: by the light continued from lit skin; on inpainted skin by the light under which the albedo is that of the
seen skin around.
"""

from __future__ import annotations

import numpy as np

from service.arrays import Float32
from service.ledger import Constant
from service.reflectance.completion import AlbedoPrior
from service.reflectance.corrections.on_light import ChartLight, LightCorrection

WIDEST = 64
"""Standard deviation of the widest blur that continues light, texels of the context."""

SEAM = 0.12
"""Share of the chart's width and height over which the two sides of the seam are blended."""

GRAIN = 3.0
"""Standard deviation of the blur below which inpainted skin keeps its own detail, texels of the context."""

BEARD_END = 8.0
"""Standard deviation of the blur over which a beard fades beyond what is seen of it, texels of the context; how far it
goes on is for the prior to tell."""

SHADED = 0.3
"""Quantile of the light on lit skin below which no continued light falls."""

DARKEST = 1e-3
"""Linear albedo at which logarithms stop."""


def continued(light: Float32, lit: Float32) -> Float32:
    """(C, h, w) light continued smoothly from lit skin to all else; unchanged where nothing or all is lit skin.

    Inpainted colour carries the light of the place that it came from, not that of its own place.

    Args:
        light: what the context network found.
        lit: (h, w) in [0, 1], where the light is to be believed.
    """
    import cv2

    weight = np.clip(lit, 0, 1).astype(np.float32)
    total = float(weight.sum())
    if total < 1:
        return light
    planes = np.ascontiguousarray(np.moveaxis(light, 0, 2), np.float32)
    weighted = planes * weight[..., None]
    filled: Float32 = np.broadcast_to(weighted.sum((0, 1)) / np.float32(total), planes.shape).astype(np.float32)
    sigma = WIDEST
    while sigma >= 2:
        near = np.asarray(cv2.GaussianBlur(weight, (0, 0), sigma), np.float32)[..., None]
        spread = np.asarray(cv2.GaussianBlur(weighted, (0, 0), sigma), np.float32).reshape(planes.shape)
        trust = near / (near + np.float32(0.02))
        filled = np.asarray(trust * spread / np.maximum(near, np.float32(1e-6)) + (1 - trust) * filled, np.float32)
        sigma //= 2
    soft = np.minimum(np.asarray(cv2.GaussianBlur(weight, (0, 0), 2), np.float32), weight)[..., None]
    return np.asarray(np.moveaxis(soft * planes + (1 - soft) * filled, 2, 0), np.float32)


def seamless(light: Float32) -> Float32:
    """(C, h, w) light that is equal on both sides of the head's seam, which runs along three borders of the chart.

    The chart is symmetric: a point of the seam lies at (x, y) and at (w - x, y). Towards it both sides approach their
    mean; light from the left would else end in a step at the middle of the crown.
    """
    _, height, width = light.shape
    x, y = np.arange(width) + 0.5, np.arange(height) + 0.5
    near = np.minimum(np.minimum(x, width - x)[None] / (width * SEAM), y[:, None] / (height * SEAM))
    far = np.clip(near, 0, 1).astype(np.float32)
    share = np.float32(0.5) * (1 - far * far * (3 - 2 * far))
    return np.asarray(light + share * (light[..., ::-1] - light), np.float32)


def with_shade_floor(everywhere: Float32, light: Float32, lit: Float32) -> Float32:
    """(C, h, w) continued light, raised to the ``SHADED`` quantile of the lit skin where it is below.

    The shade under the brim of a cap, or of a fringe, is not the light on the cap or on the hair above it.

    Args:
        everywhere: light of :func:`continued`.
        light: as it was found.
        lit: (h, w) in [0, 1], where the light is to be believed.
    """
    chosen = lit > 0.5
    if not chosen.any():
        return everywhere
    floor = np.quantile(light.mean(0)[chosen], SHADED)
    more = np.maximum(np.float32(floor) - everywhere.mean(0), 0) * (1 - np.clip(lit, 0, 1))
    return np.asarray(everywhere + more, np.float32)


def as_seen_skin(
    light: Float32,
    texture: Float32,
    found: Float32,
    lit: Float32,
    inpainted: Float32,
    shown: Float32,
    prior: AlbedoPrior | None = None,
) -> Float32:
    """(3, h, w) light under which inpainted skin has the albedo that goes with the seen skin, but for its own grain.

    Inpainted colour is continued from the photo's, with the shade of a jaw or a fringe in it, and ends in the median
    colour of the lit face. No smooth light takes both off. The albedo is the likeliest given the seen skin; what that
    has beside it is continued, so there is no step between both.

    Args:
        light: log light continued from lit skin (:func:`continued`).
        texture: (3, h, w) linear.
        found: (3, h, w) log light as the network found it, to be believed where lit.
        lit: (h, w) in [0, 1]; without any lit skin the light is returned as it is.
        inpainted: (h, w) in [0, 1], inpainted skin.
        shown: (h, w) in [0, 1], at least ``lit``: what the photo shows. A beard tells no light and is part of the
            albedo: beyond the border of what is seen it goes on.
        prior: of whole albedo maps of this chart; None: the albedo of seen skin is continued alone.
    """
    if float(lit.sum()) < 1 or not inpainted.any():
        return light
    colour = np.log(np.maximum(texture, np.float32(DARKEST)))
    seen = np.asarray(colour - (lit * found + (1 - lit) * light), np.float32)
    usual = np.zeros_like(seen) if prior is None else prior.complete(seen, shown)
    skin = continued(seen - usual, lit)
    wanted = usual + skin + _nearby((shown - lit) * (seen - usual - skin), shown)
    plain = _blurred(colour * inpainted, GRAIN) / np.maximum(_blurred(inpainted[None], GRAIN), np.float32(1e-6))
    share = np.minimum(_blurred(inpainted[None], 2.0), inpainted[None])
    return np.asarray(light + share * (plain - wanted - light), np.float32)


def _nearby(planes: Float32, shown: Float32) -> Float32:
    """(C, h, w) what is shown, 0 where nothing is to be added, gone on with and faded out over ``BEARD_END``."""
    near = _blurred(shown[None], BEARD_END)
    return np.asarray(_blurred(planes, BEARD_END) / np.maximum(near, np.float32(1e-3)) * np.minimum(2 * near, 1))


def _blurred(planes: Float32, sigma: float) -> Float32:
    """(C, h, w) Gaussian blur of each plane."""
    import cv2

    return np.stack([np.asarray(cv2.GaussianBlur(plane, (0, 0), sigma), np.float32) for plane in planes])


def everywhere(at: ChartLight) -> Float32:
    """(3, h, w) log light of the whole chart: that of lit skin, continued to all else, closed at the seam.

    Inpainted skin has the albedo of the prior in the box, where the chart is the one that it was learnt on.
    """
    light = with_shade_floor(continued(at.light, at.lit), at.found, at.weight)
    if at.inpainted.any():
        light = as_seen_skin(light, at.texture, at.found, at.weight, at.inpainted, at.shown, at.prior)
    return seamless(light)


UNSEEN_SKIN = LightCorrection(
    name="unseen-skin",
    mends="The network takes inpainted colour, hair and caps for lit or shaded skin.",
    source="light",
    constants={
        "widest": Constant(WIDEST, "texels of the context, standard deviation", "a third of the chart's width"),
        "floor": Constant(SHADED, "quantile of the light on lit skin", "chosen on photos with caps and fringes"),
        "beard": Constant(BEARD_END, "texels of the context, standard deviation", "14 mm: no border of hair is a line"),
        "grain": Constant(GRAIN, "texels of the context, standard deviation", "finer than any shade of a fold"),
        "blend": Constant(SEAM, "share of the chart's sides", "as wide as the back of the head"),
    },
    cases=("cap", "beard", "hard"),
    apply=everywhere,
)
