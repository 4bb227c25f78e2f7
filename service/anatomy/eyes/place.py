"""Eyes moved to where the photo shows them, before their gaze and lids are read.

A fit places an eye to a millimetre or two. Left there, the iris of the photo lies beside that of the head: eyes look
down that do not, and the lids, which the gaze takes along, cannot be opened as far as the photo's are.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from scipy.spatial import cKDTree

from service.anatomy.eyes.eyeball import SIDES
from service.anatomy.eyes.lids import lid_on_rim
from service.anatomy.eyes.paint import smoothstep
from service.anatomy.opening import Followed, Rim
from service.arrays import AnyFloat, Float32, Float64
from service.geometry.camera import Camera
from service.head.model import HeadModel
from service.head.regions import part_vertices

FADES_M = 0.018
"""Distance from lids and eyeball over which the skin around them follows less and less."""


def eyes_on_rims(
    head: HeadModel,
    neutral: AnyFloat,
    expression: Float64,
    camera: Camera,
    landmarks: AnyFloat,
    exact: Collection[str],
) -> Float32:
    """(V, 3) float32 metres: the head whose eyes lie at the height and tilt of the rims that were read.

    Args:
        head: the model; an eye without lids stays where it is.
        neutral: (V, 3) metres, the fitted head without expression.
        expression: (E,) activations fitted to the landmarks.
        camera: of the fit.
        landmarks: (468, >= 2) photo pixels.
        exact: sides whose rims lie on the edges of the lids; other eyes stay.
    """
    out = np.array(neutral, np.float32)
    for side in SIDES:
        if side not in exact:
            continue
        rim, found = lid_on_rim(head, neutral, expression, camera, landmarks, side, exact=True, placed=False)
        if rim is not None:
            out += _moved(head, np.asarray(neutral, np.float64), camera, side, rim, found)
    return out


def _moved(head: HeadModel, neutral: Float64, camera: Camera, side: str, rim: Rim, found: Followed) -> Float32:
    """(V, 3) by how much each vertex moves: rigidly near the eye, turned about the direction of view."""
    lids = np.flatnonzero(head.region(f"eyelid_{side}") > 0.5)
    core = np.concatenate([lids, part_vertices(head, f"eye_{side}")])
    distance = cKDTree(neutral[core]).query(neutral, distance_upper_bound=FADES_M)[0]
    weight = smoothstep(distance, FADES_M, 0.0)
    up = rim.across @ camera.rotation[:2]
    along = rim.along * rim.length @ camera.rotation[:2]
    angle = np.arctan(found.tilt)
    offset = neutral - neutral[lids].mean(0)
    x, y = offset @ along, offset @ up
    turned_x = (np.cos(angle) - 1.0) * x - np.sin(angle) * y
    turned_y = np.sin(angle) * x + (np.cos(angle) - 1.0) * y
    moved = (turned_x + found.aside_m)[:, None] * along + (turned_y + found.raised_m)[:, None] * up
    return np.asarray(weight[:, None] * moved, np.float32)
