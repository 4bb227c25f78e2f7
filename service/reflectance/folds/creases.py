"""Where the photo's expression folds the skin, in which directions, and which units do it.

Skin that an expression compresses gets folds that run across the compression (wrinkle maps of performance capture
use the same measure: Oat 2007; Bickel et al. 2008). So the strain between the neutral and the fitted mesh tells what
relief in the photo is the expression's and not the person's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from service.arrays import AnyFloat, Float32, UInt8
from service.face.fit.result import Fit
from service.geometry.chart import Chart
from service.head.model import HeadModel
from service.head.regions import vertex_mask
from service.reflectance.folds.strain import Strain

GROUPS: dict[str, tuple[str, ...]] = {
    "brows": ("browDown", "browInnerUp", "browOuterUp"),
    "eyes": ("eyeSquint", "eyeBlink", "eyeWide", "eyeLook"),
    "smile": ("mouthSmile", "cheekSquint", "mouthDimple", "mouthStretch", "noseSneer", "mouthUpperUp", "cheekPuff"),
    "mouth": ("mouth", "jaw", "tongueOut"),
}
"""Maps, and how the names of their units begin; a unit belongs to the first that fits."""

COMPRESSED = (0.04, 0.12)
"""Compression, 1 less the smallest principal stretch, up to which skin folds no more than at rest, and from which on
its folds are the expression's."""

LEAST_WEIGHT = 0.05
"""Units that the photo shows less of fold nothing."""

NEVER = (
    "brow_left", "brow_right", "lips", "eyelid_left", "eyelid_right", "mouth_inner", "eye_socket", "scalp", "ear_left",
    "ear_right", "neck",
)  # fmt: skip
"""Regions whose lines are there at rest too, or that no one sees."""

REACH = 9
"""Texels of the chart, 5 mm of the face, by which folds lie beside the compressed skin: the nasolabial fold runs
between cheek and lip, and the mesh, which has no fold, compresses both."""

DIRECTIONS = 4
"""Among which compression is told."""

ALIKE = (0.25, 0.6)
"""Squares of the cosine between compression and slope, from none to all of which the slope is a fold's: 60 and 39
degrees; a mesh of centimetres tells the direction no better."""

SMOOTH = 2.5
"""Standard deviation, in texels of the chart, by which strain is smoothed: it is constant on each polygon."""


@dataclass(frozen=True)
class Creases:
    """Folds of an expression on a chart of (h, w) texels.

    Attributes:
        weights: (DIRECTIONS, h, w) float32 in [0, 1], how much of the relief that slopes in direction k pi / DIRECTIONS
            of the tangent frame, +Y up, is the expression's.
        group: (h, w) uint8, index into :data:`GROUPS` of the units that compress most there.
        units: weights in the photo of the units of each group that folds anything.
    """

    weights: Float32
    group: UInt8
    units: Mapping[str, Mapping[str, float]]

    @classmethod
    def of(cls, chart: Chart, fit: Fit) -> Creases | None:
        """The folds of a fit; None where its expression compresses no visible skin enough.

        Args:
            chart: of the fit's head.
            fit: of the photo.
        """
        head = chart.head
        shown = {
            name: float(value)
            for name, value in zip(head.expression_names, fit.expression, strict=True)
            if abs(value) >= LEAST_WEIGHT
        }
        if not shown:
            return None
        neutral = _smoothed(chart, fit.neutral)
        stretch, across = Strain.of(neutral, _smoothed(chart, fit.vertices)).smallest()
        low, high = COMPRESSED
        ramp = np.clip((1 - stretch - low) / (high - low), 0, 1)
        weights = _spread(np.asarray(ramp * ramp * (3 - 2 * ramp) * _foldable(chart), np.float32), across)
        weights *= _foldable(chart)
        if not weights.any():
            return None
        parts = {name: {unit: shown[unit] for unit in shown if group_of(unit) == name} for name in GROUPS}
        shares = np.stack([_share(chart, head, fit.neutral, neutral, across, units) for units in parts.values()])
        group = np.asarray(shares.argmax(0), np.uint8)
        there = set(np.unique(group[weights.max(0) > 0]).tolist())
        units = {name: parts[name] for index, name in enumerate(GROUPS) if index in there}
        return cls(weights, group, units)


def group_of(unit: str) -> str:
    """Name of the group of a unit; units that belong to none, as of imported heads, are the mouth's."""
    return next((name for name, starts in GROUPS.items() if unit.startswith(starts)), "mouth")


def _share(
    chart: Chart, head: HeadModel, rest: AnyFloat, neutral: Float32, across: Float32, units: Mapping[str, float]
) -> Float32:
    """(h, w) compression across the folds by some units alone."""
    if not units:
        return np.full(across.shape[:2], -np.inf, np.float32)
    indices = [head.expression_names.index(unit) for unit in units]
    moved = rest + np.einsum("k,kvc->vc", np.array(list(units.values())), head.expression[indices].astype(np.float64))
    return np.asarray(1 - Strain.of(neutral, _smoothed(chart, moved)).along(across), np.float32)


def _spread(weight: Float32, across: Float32) -> Float32:
    """(DIRECTIONS, h, w) the largest weight, of compression in about each direction, within ``REACH``."""
    import cv2

    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * REACH + 1, 2 * REACH + 1))
    found = []
    for k in range(DIRECTIONS):
        angle = k * np.pi / DIRECTIONS
        cosine = across[..., 0] * np.float32(np.cos(angle)) + across[..., 1] * np.float32(np.sin(angle))
        alike = np.clip((cosine**2 - ALIKE[0]) / (ALIKE[1] - ALIKE[0]), 0, 1)
        found.append(cv2.GaussianBlur(cv2.dilate(weight * alike, disc), (0, 0), SMOOTH))
    return np.asarray(found, np.float32)


def _smoothed(chart: Chart, vertices: AnyFloat) -> Float32:
    import cv2

    return np.asarray(cv2.GaussianBlur(chart.fill_outside(chart.metric(vertices)), (0, 0), SMOOTH), np.float32)


def _foldable(chart: Chart) -> Float32:
    """(h, w) in [0, 1]: visible skin of the face."""
    import cv2

    skin = np.asarray(chart.part == chart.head.part_names.index("skin"), np.float32)
    never = np.clip(2 * chart.interpolate(vertex_mask(chart.head, *NEVER))[..., 0], 0, 1)
    return np.asarray(cv2.GaussianBlur(skin * (1 - never), (0, 0), SMOOTH) * skin, np.float32)
