"""Lips fitted to the photo, after pose and shape are known.

A gap of a millimetre between the lips of a closed mouth shows as a white line of teeth. The landmark network itself
leaves such a gap between closed lips; so where no teeth are seen and the gap is small, the mouth is closed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.arrays import AnyFloat, Float64
from service.face.features.rims import LEAST_FACING, Rim, fit_to_rim
from service.face.fit.result import Fit
from service.geometry.camera import Camera
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

FITTED = (0.04, 0.96)
"""Part of the way from corner to corner over which the lips are fitted."""

LEFT_OPEN = 0.02
"""Gap that the landmark network leaves between closed lips, as a share of the mouth's width."""

CLOSED = 0.085
"""Gap, as a share of the width, below which a mouth that shows no teeth is closed."""

SHUT = 0.03
"""The same of a rim that lies on the edges of the lips, teeth or not: what the network is off by on shut mouths."""


def lips_on_rim(
    head: HeadModel,
    neutral: AnyFloat,
    expression: Float64,
    camera: Camera,
    rim_points: AnyFloat,
    teeth_seen: bool,
    *,
    exact: bool = False,
) -> Float64:
    """(E,) expression, all in [0, 1], whose lips end at the rim of the photo's mouth.

    Args:
        head: the model; without lips or a legible rim the activations stay as they are.
        neutral: (V, 3) metres, the fitted head without expression.
        expression: (E,) activations fitted to the landmarks.
        camera: of the fit.
        rim_points: (20, 2) photo pixels of the opening, in the order of ``RIMS``.
        teeth_seen: whether the photo shows teeth in it.
        exact: whether the rim lies on the edges of the lips, as the landmark network's does not.
    """
    edges, rim = lip_edges(head), Rim.of(np.asarray(rim_points, np.float64), camera.rotation[:2, 1], FITTED)
    if edges is None or rim is None or not -camera.rotation[2, 2] >= LEAST_FACING:
        return np.array(expression, np.float64)
    gap = float(np.median(np.interp(rim.lower[:, 0], *rim.upper.T) - rim.lower[:, 1])) / rim.length
    closed = gap < SHUT if exact else gap < CLOSED and not teeth_seen
    extra = 0.0 if exact else LEFT_OPEN
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
