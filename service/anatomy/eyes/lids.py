"""Lids where the photo has them, after pose, shape and gaze are known.

The landmark fit knows a lid to two millimetres, and the heads of the model look out of narrower eyes than people do: an
iris that the photo shows would lie on a lid, and the lashes above it. So the edge of each lid, as the camera sees it,
is brought to the rim that the landmark network found.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.anatomy.eyes.eyeball import SIDES
from service.anatomy.eyes.gaze import LIDS, RIMS
from service.anatomy.opening import Rim, brought_to
from service.anatomy.opening_edges import lid_edges
from service.geometry.camera import Camera
from service.geometry.chart import Chart
from service.head.model import HeadModel
from service.head.regions import vertex_mask

Array = npt.NDArray[np.float64]

USED = (0.08, 0.92)
"""Part of the way from the outer corner to the inner where the heads' eyes are open; people's are a little longer."""
BEFORE_LASHES = 0.007
"""The network's upper rim lies on the roots of the lashes: this share of the eye's length above the opening."""


def lid_skin(chart: Chart) -> npt.NDArray[np.float32]:
    """(h, w) float32 >= 0: weight of the skin round the eyes; 0 where the head names no lids."""
    weight = chart.interpolate(vertex_mask(chart.head, "eyelid_left", "eyelid_right"))[..., 0]
    return np.asarray(weight * chart.mask, np.float32)


def lids_on_rims(
    head: HeadModel,
    neutral: npt.NDArray[np.floating],
    expression: Array,
    camera: Camera,
    landmarks: npt.NDArray[np.floating],
) -> Array:
    """(E,) expression whose lids end where the rims of the photo's eyes are, all in [0, 1].

    Args:
        head: the model; eyes without lids, lid units or a rim to be read keep what they have.
        neutral: (V, 3) metres, the fitted head without expression.
        expression: (E,) activations of landmarks and gaze.
        camera: of the fit.
        landmarks: (468, >= 2) photo pixels.
    """
    out = np.array(expression, np.float64)
    for side in SIDES:
        edges = lid_edges(head, side)
        rim = Rim.of(np.asarray(landmarks, np.float64)[list(RIMS[side]), :2], camera.rotation[:2, 1], USED)
        if edges is not None and rim is not None:
            names = {f"{unit}{side.capitalize()}" for unit in LIDS}
            out = brought_to(rim.lower_above(BEFORE_LASHES), edges, names, head, neutral, out, camera)
    return out
