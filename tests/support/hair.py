"""A reading of hair whose truth is known: strands of a style on a head, seen by a camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from service.arrays import Float32
from service.face.fit.fit import Fit
from service.face.region import Region
from service.geometry.camera import Camera
from service.hair.bank import view_camera
from service.hair.groom import Groom, make_groom
from service.hair.kinds import KINDS, ends_m
from service.hair.reading import CELLS, HairReading
from service.hair.scalp import Scalp
from service.hair.sight import Sight
from service.hair.style import Style
from service.head.model import HeadModel

UNTOLD: Mapping[str, Mapping[str, float]] = {
    name: {choice: 1 / len(choices) for choice in choices} for name, choices in KINDS.items()
}
"""Probabilities of a reading that knows of no kind."""


@dataclass(frozen=True)
class Photographed:
    """What a perfect reader would say of a groom.

    Attributes:
        fit: the head.
        reading: its hair; which kind it is stays open.
        groom: the truth.
        sight: the truth beside the head.
    """

    fit: Fit
    reading: HairReading
    groom: Groom
    sight: Sight


def fit_of(vertices: Float32, camera: Camera) -> Fit:
    """A fit of these vertices (V, 3) without expression."""
    return Fit(
        camera=camera, identity=np.zeros(1), expression=np.zeros(52), vertices=vertices, neutral=vertices, light=None,
        landmark_rms_px=1.0, inter_ocular_px=60.0,
    )  # fmt: skip


def photographed(
    style: Style, seed: int, head: HeadModel, vertices: Float32 | None = None, yaw: float = 0.0, pitch: float = 0.0,
    strands: int = 3000,
) -> Photographed:  # fmt: skip
    """A style on a head (V, 3), None for the mean one, from an angle in degrees."""
    points = np.asarray(head.mean if vertices is None else vertices, np.float32)
    camera, region = view_camera(yaw, pitch), Region(CELLS / 2, CELLS / 2, CELLS)
    groom = make_groom(style, seed, strands, Scalp.of(head, points))
    bare = Sight.beside(head, points, camera, region)
    drawn = bare.drawn(groom.strands)
    size = np.linalg.norm(drawn.direction, axis=-1)
    direction = np.asarray(drawn.direction / np.maximum(size, 1e-6)[..., None], np.float32)
    certainty = np.asarray(size * drawn.mask, np.float32)
    ends = ends_m(groom.strands) if len(groom) else 0.05
    none = np.zeros_like(drawn.mask)
    reading = HairReading(region, drawn.mask, none + 1, none, direction, certainty, UNTOLD, (ends, 0.02))
    fit = fit_of(points, camera)
    return Photographed(fit, reading, groom, Sight.of(reading, fit, head))
