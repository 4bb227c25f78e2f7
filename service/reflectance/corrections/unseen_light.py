"""Light in places that no photo showed, whose colour was made up.

A network that has seen lit skin only would take made-up colour for a brightly lit or shaded surface. So its light is
not asked for there: it goes on from where skin was seen, and made-up skin gets the light that makes its albedo that of
the seen skin around it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.reflectance.corrections.on_light import LightCorrection

Float = npt.NDArray[np.float32]

WIDEST = 64
"""Standard deviation of the widest blur that carries light into made-up parts, texels of the context."""

SEAM = 0.12
"""Share of the chart's width and height over which the two sides of the seam go over into each other."""

GRAIN = 3.0
"""Standard deviation of the blur below which made-up skin keeps its own detail, texels of the context."""

SHADED = 0.3
"""Share of the lit skin that is in deeper shade than anything that its light is continued to."""

DARKEST = 1e-3
"""Linear albedo at which logarithms stop."""


def continued(light: Float, lit: Float) -> Float:
    """(C, h, w) light that goes on smoothly from lit skin to all else; unchanged where nothing or all is lit skin.

    Colour that was made up was continued from the photo's and carries the light of its source, not that of its place.
    A network that has seen lit skin only would take it for a brightly lit or shaded surface, and dark hair for shade.

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
    filled: Float = np.broadcast_to(weighted.sum((0, 1)) / np.float32(total), planes.shape).astype(np.float32)
    sigma = WIDEST
    while sigma >= 2:
        near = np.asarray(cv2.GaussianBlur(weight, (0, 0), sigma), np.float32)[..., None]
        spread = np.asarray(cv2.GaussianBlur(weighted, (0, 0), sigma), np.float32).reshape(planes.shape)
        trust = near / (near + np.float32(0.02))
        filled = np.asarray(trust * spread / np.maximum(near, np.float32(1e-6)) + (1 - trust) * filled, np.float32)
        sigma //= 2
    soft = np.minimum(np.asarray(cv2.GaussianBlur(weight, (0, 0), 2), np.float32), weight)[..., None]
    return np.asarray(np.moveaxis(soft * planes + (1 - soft) * filled, 2, 0), np.float32)


def seamless(light: Float) -> Float:
    """(C, h, w) light that is the same on both sides of the head's seam, which runs along three borders of the chart.

    The chart is symmetric: a point of the seam lies at (x, y) and at (w - x, y). Towards it both sides go over into
    their mean; light from the left would else end at the middle of the crown.
    """
    _, height, width = light.shape
    x, y = np.arange(width) + 0.5, np.arange(height) + 0.5
    near = np.minimum(np.minimum(x, width - x)[None] / (width * SEAM), y[:, None] / (height * SEAM))
    far = np.clip(near, 0, 1).astype(np.float32)
    share = np.float32(0.5) * (1 - far * far * (3 - 2 * far))
    return np.asarray(light + share * (light[..., ::-1] - light), np.float32)


def with_shade_floor(everywhere: Float, light: Float, lit: Float) -> Float:
    """(C, h, w) light that went on from lit skin, less deep than the shaded part of the face where that ends.

    The shade under the brim of a cap, or of a fringe, is not that of the cap or of the hair above it.

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


def as_seen_skin(light: Float, texture: Float, found: Float, lit: Float, inpainted: Float) -> Float:
    """(3, h, w) light under which made-up skin has the albedo of seen skin around it, but for its own fine grain.

    The colour of made-up skin is continued from the photo's, with the shade of a jaw or a fringe in it, and ends in the
    median colour of a face lit as it may be. No light that goes on smoothly takes both off.

    Args:
        light: log light that goes on from lit skin (:func:`continued`).
        texture: (3, h, w) linear.
        found: (3, h, w) log light as the network found it, to be believed where lit.
        lit: (h, w) in [0, 1]; without any lit skin the light is returned as it is.
        inpainted: (h, w) in [0, 1], skin that no photo showed.
    """
    if float(lit.sum()) < 1 or not inpainted.any():
        return light
    colour = np.log(np.maximum(texture, np.float32(DARKEST)))
    wanted = continued(np.asarray(colour - found, np.float32), lit)
    plain = _blurred(colour * inpainted, GRAIN) / np.maximum(_blurred(inpainted[None], GRAIN), np.float32(1e-6))
    share = np.minimum(_blurred(inpainted[None], 2.0), inpainted[None])
    return np.asarray(light + share * (plain - wanted - light), np.float32)


def _blurred(planes: Float, sigma: float) -> Float:
    """(C, h, w) Gaussian blur of each plane."""
    import cv2

    return np.stack([np.asarray(cv2.GaussianBlur(plane, (0, 0), sigma), np.float32) for plane in planes])


UNSEEN_LIGHT = LightCorrection(
    name="unseen-light",
    mends="The network takes colour that was inpainted, and hair, for lit or shaded skin.",
    source="light",
    cases=("soft", "hard", "beard"),
    apply=lambda at: with_shade_floor(continued(at.light, at.lit), at.found, at.weight),
)

INPAINTED_SKIN = LightCorrection(
    name="inpainted-skin",
    mends="Inpainted skin keeps the shade of the photo's skin that it was continued from.",
    source="light",
    cases=("hard",),
    apply=lambda at: as_seen_skin(at.light, at.texture, at.found, at.lit, at.inpainted)
    if at.inpainted.any()
    else at.light,
)

CHART_SEAM = LightCorrection(
    name="chart-seam",
    mends="Light from one side ends in a step along the chart's seam at the back of the head.",
    source="light",
    cases=("hard",),
    apply=lambda at: seamless(at.light),
)
