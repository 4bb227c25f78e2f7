"""Lids fitted to the photo, after pose, shape and gaze are known.

The landmark fit places a lid to two millimetres only, and the model's lid openings are narrower than people's: without
more, an iris that the photo shows would be painted on a lid, and the lashes above it. So the edge of each lid, as the
camera sees it, is brought to the rim that the landmark network found.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from service.anatomy.eyes.eyeball import SIDES
from service.anatomy.eyes.gaze import LID_UNITS, RIMS
from service.anatomy.opening import Followed, Rim, fit_to_rim
from service.anatomy.opening_edges import lid_edges
from service.arrays import AnyFloat, Float32, Float64
from service.geometry.camera import Camera
from service.geometry.chart import Chart
from service.head.model import HeadModel
from service.head.regions import vertex_mask

FITTED = (0.08, 0.92)
"""Part of the way from the outer corner to the inner over which lids are fitted: there the model's eyes are open;
people's openings are a little longer."""

LASH_ROOTS = 0.007
"""Height of the landmark network's upper rim, which lies on the roots of the lashes, above the opening, as a share of
the eye's length."""

SHUT = 0.03
"""Opening of a rim that lies on the edges of the lids, as a share of its length, below which the eye is closed: what
the network is off by on closed eyes."""


def lid_skin(chart: Chart) -> Float32:
    """(h, w) float32 >= 0: weight of the eyelids; 0 where the head names none."""
    weight = chart.interpolate(vertex_mask(chart.head, "eyelid_left", "eyelid_right"))[..., 0]
    return np.asarray(weight * chart.mask, np.float32)


def lids_on_rims(
    head: HeadModel,
    neutral: AnyFloat,
    expression: Float64,
    camera: Camera,
    landmarks: AnyFloat,
    exact: Collection[str] = (),
) -> Float64:
    """(E,) expression, all in [0, 1], whose lids end at the rims of the photo's eyes.

    Args:
        head: the model; eyes without lids, lid units or a legible rim keep their activations.
        neutral: (V, 3) metres, the fitted head without expression.
        expression: (E,) activations fitted to landmarks and gaze.
        camera: of the fit.
        landmarks: (468, >= 2) photo pixels.
        exact: sides whose rims lie on the edges of the lids; the others' upper rims lie on the roots of the lashes.
    """
    out = np.array(expression, np.float64)
    for side in SIDES:
        out = lid_on_rim(head, neutral, out, camera, landmarks, side, exact=side in exact)[1].expression
    return out


def lid_on_rim(
    head: HeadModel,
    neutral: AnyFloat,
    expression: Float64,
    camera: Camera,
    landmarks: AnyFloat,
    side: str,
    *,
    exact: bool,
    placed: bool = True,
) -> tuple[Rim | None, Followed]:
    """One eye's rim, None where it is not legible, and how the lids follow it, arguments as of :func:`lids_on_rims`.

    ``placed``: the eye lies where it should.
    """
    edges = lid_edges(head, side)
    rim = Rim.of(np.asarray(landmarks, np.float64)[list(RIMS[side]), :2], camera.rotation[:2, 1], FITTED)
    if edges is None or rim is None:
        return None, Followed(np.array(expression, np.float64))
    names, start = {f"{unit}{side.capitalize()}" for unit in LID_UNITS}, np.array(expression, np.float64)
    if not exact:
        return rim, fit_to_rim(rim.lower_above(LASH_ROOTS), edges, names, head, neutral, start, camera)
    if rim.gap < SHUT:
        # Lids that meet in this view may be apart in others: only where they meet is fitted.
        rim, start, names = rim.narrower(rim.length), _shut(head, start, side), {f"eyeSquint{side.capitalize()}"}
    return rim, fit_to_rim(rim, edges, names, head, neutral, start, camera, placed=placed)


def _shut(head: HeadModel, expression: Float64, side: str) -> Float64:
    """(E,) the expression with one eye closed, whose lids no gaze takes along."""
    out = np.array(expression, np.float64)
    place = {name: k for k, name in enumerate(head.expression_names)}
    for unit in ("eyeBlink", "eyeWide", "eyeLookUp", "eyeLookDown"):
        if (name := f"{unit}{side.capitalize()}") in place:
            out[place[name]] = float(unit == "eyeBlink")
    return out
