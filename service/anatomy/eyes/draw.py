"""Eyes in the detail of the map.

An iris is six texels wide in the photo's texture, and no network here has learnt to enlarge it. Its colours are known
well, though, and so is how an eye is made: pupil, fibres that run outwards from it, a darker rim, a white with vessels.
So eyes are drawn anew, in the colours that their albedo has.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.anatomy.eyes.paint import BRIGHTEST, IRIS_RADIUS_M, PUPIL_RADIUS_M, SOCKET, paint_eye
from service.anatomy.part_texels import PartTexels
from service.colour import FULL_CODE, Codes, linear_to_srgb, luma, srgb_to_linear
from service.head.model import HeadModel

Float = npt.NDArray[np.float32]

IRIS, SCLERA = (0.5, 0.85), (1.25, 1.8)
"""Where the albedo tells the colours, in radii of the iris."""
LIGHTEST_IRIS, MOST_IRIS, LEAST_IRIS = 0.2, 0.32, np.array([0.020, 0.014, 0.010], np.float32)
"""Luminance of the palest iris, its largest channel, and the channels of the darkest, linear: a white that was seen in
the shade of the lids, or skin that was taken for an iris, makes it glow."""
REDDEST_IRIS, LEAST_BLUE = 2.5, 0.4
"""Red and blue over green, linear, of the brownest."""
FEW = 12
"""With fewer texels than this they are not told."""
FIBRES, FIBRE_DEPTH = 28, 0.16
"""Cosines round the iris that make up its fibres, and their standard deviation, as a share of the colour."""
MOST_FIBRES = 70.0
"""Of the finest of them round the iris; less where a texel does not resolve that."""
COLLARETTE, COLLARETTE_WIDTH, COLLARETTE_LIGHT = 0.52, 0.07, 0.12
"""The frill between the iris's inner and outer zone: radius, width, and by how much it is lighter."""
VESSELS, VESSEL_WIDTH = 0.16, 0.09
"""Share of green and blue that vessels take from the white at most, and their width as a share of noise."""


@dataclass(frozen=True)
class Eyeball:
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
    def of(cls, place: PartTexels) -> Eyeball | None:
        """None where no texel of its iris is on the map."""
        low, high = place.vertices.min(0), place.vertices.max(0)
        reach = max(float((high - low).max()) / 2, 1e-6)
        ray = place.points - (low + high) / 2
        ray /= np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), 1e-9)
        limbus, pupil = (float(np.arcsin(min(r / reach, 0.9))) for r in (IRIS_RADIUS_M, PUPIL_RADIUS_M))
        radius = (np.arccos(np.clip(ray[:, 2], -1, 1)) / limbus).astype(np.float32)
        within = int((radius < 1).sum())
        if not within:
            return None
        turn, texel = np.arctan2(ray[:, 1], ray[:, 0]).astype(np.float32), float(np.sqrt(np.pi / within))
        return cls(place, radius, turn, ray.astype(np.float32), np.degrees(limbus), np.degrees(pupil), texel)


def eyeballs(head: HeadModel, size: tuple[int, int]) -> list[Eyeball]:
    """The eyes of a head on its chart of a size (width, height); of imported heads there may be none."""
    places = (PartTexels.of(head, name, size) for name in head.part_names if name.startswith("eye"))
    found = (Eyeball.of(place) for place in places if place is not None)
    return [eye for eye in found if eye is not None]


def draw_eyes(
    albedo: Codes, head: HeadModel, detail: float = 1.0, iris_albedo: npt.NDArray[np.floating] | None = None
) -> Codes:
    """The albedo, changed in place: eyes in the detail of the map and in the colours that they had.

    Args:
        albedo: (H, W, 3) codes of sRGB.
        head: whose chart it is; stays as it is where it has no eyes, or too few texels of them.
        detail: strength of fibres and vessels, which are made up, in [0, 1]. The iris's colour is their seed.
        iris_albedo: (3,) linear; None: as on the map.
    """
    eyes = eyeballs(head, (albedo.shape[1], albedo.shape[0]))
    shown = [albedo[eye.place.box][eye.place.inside] * np.float32(1 / FULL_CODE) for eye in eyes]
    tones = [_tone(eyes, shown, where) for where in (IRIS, SCLERA)]
    iris, sclera = tones
    if iris is None or sclera is None:
        return albedo
    iris = likely_iris(srgb_to_linear(iris) if iris_albedo is None else np.asarray(iris_albedo, np.float32))
    for eye in eyes:
        # The same on both eyes but for the turn: a person's eyes are alike.
        random = np.random.default_rng(np.rint(iris * 255).astype(int))
        painted = paint_eye(eye.radius * eye.limbus, eye.limbus, eye.pupil, sclera, iris, SOCKET)
        linear = srgb_to_linear(painted) * _fibres(eye, random)[:, None] ** np.float32(detail)
        linear[:, 1:] *= 1 - np.float32(detail) * _vessels(eye, random)[:, None]
        drawn = np.rint(np.clip(linear_to_srgb(np.clip(linear, 0, BRIGHTEST)), 0, 1) * FULL_CODE)
        albedo[eye.place.box][eye.place.inside] = drawn.astype(albedo.dtype)
    return albedo


def likely_iris(linear: Float) -> Float:
    """(3,) sRGB of an albedo (3,) >= 0, no brighter and no darker than irises are, and neither purple nor red.

    Brown, green, blue and grey have at least as much green as the geometric mean of red and blue. A purple one is brown
    with the blue of the sky, a red one is brown in the light of a lamp, or flashed at.
    """
    red, green, blue = np.maximum(linear, np.float32(1e-4))
    linear = np.array([red, green, min(blue, green * green / red)], np.float32)
    if red > REDDEST_IRIS * green:
        brown = np.array([REDDEST_IRIS, 1.0, max(linear[2] / green, LEAST_BLUE)], np.float32)
        linear = brown * np.float32(luma(linear) / luma(brown))
    excess = max(1.0, float(luma(linear)) / LIGHTEST_IRIS, float(linear.max()) / MOST_IRIS)
    return linear_to_srgb(np.maximum(linear / np.float32(excess), LEAST_IRIS))


def _tone(eyes: list[Eyeball], shown: list[Float], where: tuple[float, float]) -> Float | None:
    """(3,) median colour of the texels between two radii; None where there are too few."""
    chosen = [c[(e.radius > where[0]) & (e.radius < where[1])] for e, c in zip(eyes, shown, strict=True)]
    colours = np.concatenate(chosen) if chosen else np.zeros((0, 3), np.float32)
    return np.asarray(np.median(colours, 0), np.float32) if len(colours) >= FEW else None


def _fibres(eye: Eyeball, random: np.random.Generator) -> Float:
    """(N,) factor of the iris's colour: fibres, and the frill round its inner zone; 1 on pupil and sclera."""
    finest = min(MOST_FIBRES, np.pi * IRIS[0] / max(eye.texel, 1e-6))
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


def _vessels(eye: Eyeball, random: np.random.Generator) -> Float:
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
