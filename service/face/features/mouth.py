"""Lips and teeth of the photo: lips on their rim, which pixels are teeth, their colour, and the light on them.

A gap of a millimetre between the lips of a closed mouth shows as a white line of teeth. The landmark network itself
leaves such a gap between closed lips; so where no teeth are seen and the gap is small, the mouth is closed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from service.arrays import AnyFloat, Float32, Float64, UInt8
from service.colour import luma, srgb_to_linear
from service.face.features.eyes import SeenRims
from service.face.features.rims import LEAST_FACING, RIMS, Rim, fit_to_rim, inside_rim
from service.face.fit.fit import Fit
from service.head.model import HeadModel
from service.head.regions import lip_edges

PAIRED = ("mouthUpperUp", "mouthLowerDown", "mouthPress", "mouthFrown", "mouthDimple", "mouthSmile", "mouthStretch")
UNITS = {"mouthClose", "mouthRollUpper", "mouthRollLower", "mouthShrugUpper", "mouthShrugLower"} | {
    f"{unit}{side}" for unit in PAIRED for side in ("Left", "Right")
}
"""Expression units that move the lips alone. The jaw is already fitted to the outline of the face; where the rim lies
on the edges of the lips, which tell its opening better than the chin does, it moves with them."""

OPENERS = {"mouthFunnel", "tongueOut"} | {
    f"{unit}{side}" for unit in ("mouthUpperUp", "mouthLowerDown") for side in ("Left", "Right")
}
"""Units beside ``jawOpen`` that part the lips; without them ``mouthClose`` = ``jawOpen`` seals."""

SHIFTERS = UNITS - OPENERS - {"mouthClose"}
"""Units that move sealed lips without parting them."""

SHUT = 0.03
"""The same of a rim that lies on the edges of the lips, teeth or not: what the network is off by on shut mouths."""


def lips_on_rim(head: HeadModel, neutral: AnyFloat, seen: SeenRims, teeth_seen: bool) -> Float64:
    """(E,) expression, all in [0, 1], whose lips end at the rim of the photo's mouth.

    Args:
        head: the model; without lips or a legible rim the activations stay as they are.
        neutral: (V, 3) metres, the fitted head without expression.
        seen: the rim; the landmark network's does not lie on the edges of the lips.
        teeth_seen: whether the photo shows teeth in the opening.
    """
    expression, camera, exact = seen.expression, seen.camera, "mouth" in seen.exact
    # Part of the way from corner to corner over which the lips are fitted.
    points, used = np.asarray(seen.landmarks, np.float64)[list(RIMS["mouth"]), :2], (0.04, 0.96)
    edges, rim = lip_edges(head), Rim.of(points, camera.rotation[:2, 1], used)
    if edges is None or rim is None or not -camera.rotation[2, 2] >= LEAST_FACING:
        return np.array(expression, np.float64)
    gap = float(np.median(np.interp(rim.lower[:, 0], *rim.upper.T) - rim.lower[:, 1])) / rim.length
    # Gap, as a share of the width, below which a mouth that shows no teeth is closed.
    closed = gap < SHUT if exact else gap < 0.085 and not teeth_seen
    # Gap that the landmark network leaves between closed lips, as a share of the mouth's width.
    extra = 0.0 if exact else 0.02
    start = np.array(expression, np.float64)
    if closed:
        rim, units, start = rim.narrower(rim.length), SHIFTERS, sealed(head, start)
    else:
        rim, units = rim.narrower(extra * rim.length), UNITS | ({"jawOpen"} if exact else set())
    return fit_to_rim(rim, edges, units, head, neutral, start, camera).expression


def with_mouth_shut(head: HeadModel, fit: Fit) -> Fit:
    """The fit with lips and jaw closed; the corners of the mouth stay as they are."""
    expression = sealed(head, fit.expression)
    for unit in {"jawOpen", "mouthClose"} & set(head.expression_names):
        expression[head.expression_names.index(unit)] = 0.0
    return replace(fit, expression=expression, vertices=head.expressed(fit.neutral, expression))


def sealed(head: HeadModel, expression: Float64) -> Float64:
    """(E,) the expression without what parts the lips, and with the jaw's share of it closed."""
    out = np.array(expression, np.float64)
    place = {name: k for k, name in enumerate(head.expression_names)}
    out[[place[name] for name in OPENERS if name in place]] = 0.0
    if "mouthClose" in place and "jawOpen" in place:
        out[place["mouthClose"]] = out[place["jawOpen"]]
    return out


TOOTH = np.array([0.74, 0.68, 0.60], np.float32)
"""Wet teeth as photos show them: slightly yellow."""

LEAST_PIXELS, LEAST_SHARE = 24, 0.08
"""Fewest pixels of teeth, and their smallest share of the opening between the lips."""

LEAST_LUMA = 0.55
"""Smallest luma of teeth over the skin's."""

CLIPPED = 252 / 255
"""sRGB value from which on a colour may be overexposed."""


def measure_teeth(pixels: UInt8, rim: AnyFloat, skin: npt.ArrayLike) -> Float32 | None:
    """(3,) sRGB median of the brighter half of the teeth between the lips, or None where none are seen.

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        rim: (N, 2) pixels round the opening between the lips, in order.
        skin: (3,) sRGB of the face; teeth are less red than it and not much darker.
    """
    typical = np.asarray(skin, np.float32)
    colour, _ = inside_rim(pixels, rim, 0.0)
    pale = colour[toothlike(colour, typical) > 0.5]
    pale = pale[luma(pale) > LEAST_LUMA * float(luma(typical))]
    if len(pale) < max(LEAST_PIXELS, LEAST_SHARE * len(colour)):
        return None
    order = np.argsort(luma(pale), kind="stable")
    return np.asarray(np.median(pale[order[len(order) // 2 :]], 0), np.float32)


def toothlike(colour: Float32, skin: Float32) -> Float32:
    """(n,) in [0, 1]: 1 where sRGB colours (n, 3) are clearly less red than the skin (3,), as teeth are, not lips."""
    # Largest redness of teeth over the skin's.
    limit = 0.75 * float(_redness(skin))
    return np.asarray(np.clip((limit - _redness(colour)) / 0.05 + 1, 0, 1), np.float32)


def _redness(colour: Float32) -> Float32:
    """(...) red less the mean of green and blue, over red: the ratio makes it independent of the brightness."""
    return np.asarray((colour[..., 0] - colour[..., 1:].mean(-1)) / np.maximum(colour[..., 0], 0.02), np.float32)


def teeth_light(tooth: Float32, skin: npt.ArrayLike) -> Float64 | None:
    """Light on the front teeth.

    Args:
        tooth: (3,) sRGB of the teeth (:func:`measure_teeth`).
        skin: (3,) sRGB of the face, in about the same light.

    Returns:
        (3,) linear RGB radiance, finite and positive, that a white diffuse surface would have in their place; None
        where they are overexposed or not surely teeth.
    """
    if (tooth > CLIPPED).any():
        return None
    shown, typical = (srgb_to_linear(np.asarray(c, np.float32)).astype(np.float64) + 1e-4 for c in (tooth, skin))
    ratio = (shown[1:] / shown[0]) / (typical[1:] / typical[0])
    # Smallest green over red and blue over red of teeth, each divided by the skin's, which cancels the colour of the
    # light. By their reflectances it is 1.4 and more; of lips and tongue below 1.
    return np.asarray(shown / TOOTH.astype(np.float64)) if (ratio >= (1.25, 1.3)).all() else None
