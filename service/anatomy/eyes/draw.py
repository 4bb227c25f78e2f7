"""Eyes in the detail of the map.

An iris is six texels wide in the photo's texture, and no network here has learnt to enlarge it. Its colours are
measured in the photo, though, and how an eye is made is known: pupil, fibres that run outwards from it, a darker rim, a
sclera with vessels. So eyes are drawn on the map, in the measured colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.anatomy.eyes.colours import BRIGHTEST, IRIS, SCLERA, SOCKET, likely_iris
from service.anatomy.eyes.eyeball import Eyeball
from service.anatomy.eyes.paint import paint_eye
from service.anatomy.part_texels import PartTexels
from service.colour import FULL_CODE, Codes, linear_to_srgb, srgb_to_linear
from service.head.model import HeadModel

Float = npt.NDArray[np.float32]

RING = (0.5, 0.85)
"""Where an albedo tells the iris's colour, in radii of the iris."""
FEW = 12
"""Fewest texels of that ring from which the colour is told."""
FIBRES, FIBRE_DEPTH = 28, 0.16
"""Cosines round the iris that make up its fibres, and their standard deviation, as a share of the colour."""
MOST_FIBRES = 70.0
"""Of the finest of them round the iris; less where a texel does not resolve that."""
COLLARETTE, COLLARETTE_WIDTH, COLLARETTE_LIGHT = 0.52, 0.07, 0.12
"""The frill between the iris's inner and outer zone: radius, width, and by how much it is lighter."""
VESSELS, VESSEL_WIDTH = 0.16, 0.09
"""Share of green and blue that vessels take from the white at most, and their width as a share of noise."""


@dataclass(frozen=True)
class DrawnEye:
    """One eye on the map.

    Attributes:
        place: its texels.
        radius: (N,) float32 angle from the line of sight over that of the iris's rim, of the texels inside.
        turn: (N,) float32 radians round the line of sight.
        direction: (N, 3) float32 from the middle of the eye.
        limbus: degrees from the line of sight to the iris's rim.
        pupil: degrees to that of the pupil.
        texel: size of a texel near the iris in radii of the iris.
    """

    place: PartTexels
    radius: Float
    turn: Float
    direction: Float
    limbus: float
    pupil: float
    texel: float

    @classmethod
    def of(cls, place: PartTexels) -> DrawnEye | None:
        """None where no texel of its iris is on the map."""
        ball = Eyeball.of(place.vertices)
        ray = ball.rays(place.points)
        limbus = np.radians(ball.limbus_deg)
        radius = (np.arccos(np.clip(ray[:, 2], -1, 1)) / limbus).astype(np.float32)
        within = int((radius < 1).sum())
        if not within:
            return None
        turn, texel = np.arctan2(ray[:, 1], ray[:, 0]).astype(np.float32), float(np.sqrt(np.pi / within))
        return cls(place, radius, turn, ray.astype(np.float32), ball.limbus_deg, ball.pupil_deg, texel)


def eyeballs(head: HeadModel, size: tuple[int, int]) -> list[DrawnEye]:
    """The eyes of a head on its chart of a size (width, height); of imported heads there may be none."""
    places = (PartTexels.of(head, name, size) for name in head.part_names if name.startswith("eye"))
    found = (DrawnEye.of(place) for place in places if place is not None)
    return [eye for eye in found if eye is not None]


def draw_eyes(
    albedo: Codes, head: HeadModel, detail: float = 1.0, iris_albedo: npt.NDArray[np.floating] | None = None
) -> Codes:
    """The albedo, changed in place: eyes in the detail of the map.

    Args:
        albedo: (H, W, 3) codes of sRGB.
        head: whose chart it is; stays as it is where it has no eyes, or too few texels of them.
        detail: strength of fibres and vessels, which are made up, in [0, 1]. The iris's colour is their seed.
        iris_albedo: (3,) linear; None: as on the map.
    """
    eyes = eyeballs(head, (albedo.shape[1], albedo.shape[0]))
    if sum(int((eye.radius < RING[1]).sum()) for eye in eyes) < FEW:
        return albedo
    iris = likely_iris(_shown(albedo, eyes) if iris_albedo is None else np.asarray(iris_albedo, np.float32))
    sclera, coded, socket = (linear_to_srgb(colour) for colour in (SCLERA, iris, SOCKET))
    for eye in eyes:
        # The same on both eyes but for the turn: a person's eyes are alike.
        random = np.random.default_rng(np.rint(coded * 255).astype(int))
        painted = paint_eye(eye.radius * eye.limbus, eye.limbus, eye.pupil, sclera, coded, socket)
        linear = srgb_to_linear(painted) * _fibres(eye, random)[:, None] ** np.float32(detail)
        linear[:, 1:] *= 1 - np.float32(detail) * _vessels(eye, random)[:, None]
        drawn = np.rint(np.clip(linear_to_srgb(np.clip(linear, 0, BRIGHTEST)), 0, 1) * FULL_CODE)
        albedo[eye.place.box][eye.place.inside] = drawn.astype(albedo.dtype)
    return albedo


def _shown(albedo: Codes, eyes: list[DrawnEye]) -> Float:
    """(3,) linear median colour of the irises on a map; the usual iris where they have too few texels."""
    chosen = [albedo[e.place.box][e.place.inside][(e.radius > RING[0]) & (e.radius < RING[1])] for e in eyes]
    codes = np.concatenate(chosen)
    return srgb_to_linear(np.median(codes, 0) / FULL_CODE) if len(codes) >= FEW else IRIS


def _fibres(eye: DrawnEye, random: np.random.Generator) -> Float:
    """(N,) factor of the iris's colour: fibres, and the frill round its inner zone; 1 on pupil and sclera."""
    finest = min(MOST_FIBRES, np.pi * RING[0] / max(eye.texel, 1e-6))
    often = np.rint(np.exp(random.uniform(np.log(3), np.log(max(finest, 4)), FIBRES)))
    start, bend = random.uniform(0, 2 * np.pi, FIBRES), random.normal(0, 1.5, FIBRES)
    fade = random.uniform(0, 2 * np.pi, FIBRES)
    r, noise = eye.radius, np.zeros(len(eye.radius), np.float32)
    near = r < 1.2
    for n, phase, slant, along in zip(often, start, bend, fade, strict=True):
        wave = np.cos(n * eye.turn[near] + phase + slant * r[near]) * (1 + 0.6 * np.cos(6 * r[near] + along))
        noise[near] += wave.astype(np.float32)
    wavy = COLLARETTE + 0.03 * np.cos(5 * eye.turn + start[0]) + 0.02 * np.cos(11 * eye.turn + start[1])
    frill = COLLARETTE_LIGHT * np.exp(-(((r - wavy) / COLLARETTE_WIDTH) ** 2))
    rim = _rise(r, 1.05, 0.9) * _rise(r, 0.95, 1.15, eye.pupil / eye.limbus)
    factor = np.exp(FIBRE_DEPTH * np.sqrt(2 / FIBRES) * noise + frill)
    return np.asarray(1 + rim * (factor - 1), np.float32)


def _vessels(eye: DrawnEye, random: np.random.Generator) -> Float:
    """(N,) share of green and blue that is taken by vessels: ridges of a noise, denser towards the corners."""
    noise = np.zeros(len(eye.radius), np.float32)
    for scale in (5.0, 9.0, 16.0, 30.0):
        axes = random.normal(0, scale, (6, 3)).astype(np.float32)
        noise += np.cos(eye.direction @ axes.T + random.uniform(0, 2 * np.pi, 6)).sum(1).astype(np.float32) / 6
    ridge = np.exp(-((noise / VESSEL_WIDTH) ** 2))
    return np.asarray(VESSELS * ridge * _rise(eye.radius, 1.2, 2.6), np.float32)


def _rise(value: Float, start: float, end: float, unit: float = 1.0) -> Float:
    """Smoothstep from 0 at ``start`` to 1 at ``end``, in units of ``unit``."""
    t = np.clip((value / unit - start) / (end - start), 0, 1)
    return np.asarray(t * t * (3 - 2 * t), np.float32)
