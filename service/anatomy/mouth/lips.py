"""Lips where the photo has them, after pose and shape are known.

A millimetre between the lips of a closed mouth shows as a white line of teeth. The landmark network itself leaves one
between the inner edges of closed lips; so where no teeth are seen and the gap is small, the mouth is closed.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.anatomy.opening import Rim, brought_to
from service.anatomy.opening_edges import lip_edges
from service.geometry.camera import Camera
from service.head.model import HeadModel

Array = npt.NDArray[np.float64]

MOUTH_RIM = (78, 191, 80, 81, 82, 13, 312, 311, 310, 415, 308, 324, 318, 402, 317, 14, 87, 178, 88, 95)
"""Landmarks round the opening between the lips."""
PAIRED = ("mouthUpperUp", "mouthLowerDown", "mouthPress", "mouthFrown", "mouthDimple", "mouthSmile", "mouthStretch")
UNITS = {"mouthClose", "mouthRollUpper", "mouthRollLower", "mouthShrugUpper", "mouthShrugLower"} | {
    f"{unit}{side}" for unit in PAIRED for side in ("Left", "Right")
}
"""Units of the lips alone: the jaw is known from the outline of the face."""
USED = (0.04, 0.96)
"""Part of the way from corner to corner where lips meet or part."""
LEFT_OPEN = 0.02
"""Gap that the network leaves between closed lips, as a share of the mouth's width."""
CLOSED = 0.085
"""Gap up to which a mouth without teeth to be seen is closed, likewise."""


def lips_on_rim(
    head: HeadModel,
    neutral: npt.NDArray[np.floating],
    expression: Array,
    camera: Camera,
    rim_points: npt.NDArray[np.floating],
    teeth_seen: bool,
) -> Array:
    """(E,) expression whose lips end where the rim of the photo's mouth is, all in [0, 1].

    Args:
        head: the model; without lips or a rim to be read it keeps what it has.
        neutral: (V, 3) metres, the fitted head without expression.
        expression: (E,) activations of the landmarks.
        camera: of the fit.
        rim_points: (20, 2) photo pixels of the opening, in the order of ``MOUTH_RIM``.
        teeth_seen: whether the photo shows teeth in it.
    """
    # From the subject's left corner along the lower lip: the order of the eyes' rims.
    points = np.roll(np.asarray(rim_points, np.float64), len(rim_points) // 2, axis=0)
    edges, rim = lip_edges(head), Rim.of(points, camera.rotation[:2, 1], USED)
    if edges is None or rim is None:
        return np.array(expression, np.float64)
    gap = float(np.median(np.interp(rim.lower[:, 0], *rim.upper.T) - rim.lower[:, 1])) / rim.length
    closed = gap < CLOSED and not teeth_seen
    return brought_to(
        rim.narrower((1.0 if closed else LEFT_OPEN) * rim.length), edges, UNITS, head, neutral, expression, camera
    )
