"""Eyes painted on the head's chart: by the angle from the line of sight, with fibres and vessels, shaded by the lids.

An iris is six texels wide in the photo's texture, and no network here has learnt to enlarge it. But its colour is
measured in the photo, and the structure of an eye is known: pupil, radial fibres, a darker limbus, a sclera with blood
vessels. So eyes are drawn on the map in the measured colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.anatomy.canvas import PartTexels, part_points
from service.arrays import AnyFloat, Float32
from service.colour import FULL_CODE, Codes, linear_to_srgb, srgb_to_linear
from service.face.features.eye_colours import IRIS, SCLERA, likely_iris
from service.geometry.chart import Chart
from service.head.eyeball import Eyeball
from service.head.model import HeadModel
from service.robust import smoothstep

SOCKET = np.array([0.358, 0.127, 0.108], np.float32)
"""Conjunctiva between eyeball and lids."""

BRIGHTEST = 0.85
"""Largest albedo of an eye or a tooth."""

LID_SHADE = ((-0.55, 0.75), (-0.30, 0.95), (-0.05, 1.0), (0.10, 0.87), (0.23, 0.55), (0.6, 0.4))
"""Pairs of height on the eyeball over its radius, and the factor of the lids' shade there on sRGB values. For the
texture only, which has the photo's light baked in."""

CORNER_SHADE = ((0.45, 1.0), (0.85, 0.75))
"""The same by horizontal distance over the radius, towards the corners of the lids."""


def paint_eye(angle: Float32, limbus: float, pupil: float, iris: Float32) -> Float32:
    """(N, 3) sRGB of an eyeball by the angle (N,) in degrees from its line of sight.

    Pupil, iris with a dark limbus, sclera that reddens towards the socket.

    Args:
        angle: (N,) degrees.
        limbus: angle of the iris's rim, degrees.
        pupil: angle of the pupil's rim, degrees.
        iris: (3,) linear albedo.
    """
    sclera, coded, socket = (linear_to_srgb(colour) for colour in (SCLERA, iris, SOCKET))
    colour = np.broadcast_to(coded, (len(angle), 3)) * (1 + 0.25 * _blend(angle, 0.9 * limbus, 0.4 * limbus))
    colour = colour * (1 - 0.45 * _blend(angle, 0.82 * limbus, limbus))
    colour = colour * (1 - 0.85 * _blend(angle, 1.15 * pupil, 0.9 * pupil))
    pale = sclera + (socket - sclera) * (0.9 * _blend(angle, 1.6 * limbus, 4.0 * limbus))
    return np.asarray(np.clip(colour + (pale - colour) * _blend(angle, 0.94 * limbus, 1.1 * limbus), 0, 1), np.float32)


def _blend(value: Float32, low: float, high: float) -> Float32:
    """:func:`smoothstep` of (N,) as (N, 1)."""
    return smoothstep(value, low, high)[:, None]


def on_eyeball(chart: Chart, part: int) -> tuple[Eyeball, AnyFloat]:
    """The eyeball of a part of the neutral mean head, and points (n, 3) of its inner texels, metres."""
    points, vertices = part_points(chart, part, np.flatnonzero(chart.inner_part == part))
    return Eyeball.of(vertices), points


def sight_angle(ball: Eyeball, points: AnyFloat) -> Float32:
    """(n,) degrees between the line of sight, +Z in the neutral head, and the directions of points (n, 3)."""
    return np.asarray(np.degrees(np.arccos(np.clip(ball.rays(points)[:, 2], -1.0, 1.0))), np.float32)


def lid_shade(ball: Eyeball, points: AnyFloat) -> Float32:
    """(n, 1) factor on sRGB values by which the lids shade points (n, 3) of an eyeball."""
    x, y, _ = (points - ball.centre).T / max(ball.radius, 1e-6)
    lids, corners = np.array(LID_SHADE).T, np.array(CORNER_SHADE).T
    return np.asarray(np.interp(y, *lids) * np.interp(np.abs(x), *corners), np.float32)[:, None]


RING = (0.5, 0.85)
"""Inner and outer radius of the ring in which the iris's colour is read off an albedo, in iris radii."""

LEAST_TEXELS = 12
"""Fewest texels of that ring from which the colour is read."""

FIBRES, FIBRE_DEPTH = 28, 0.16
"""Number of cosines round the iris whose sum makes its fibres, and the amplitude of the sum in natural logarithms."""

COLLARETTE, COLLARETTE_WIDTH, COLLARETTE_LIGHT = 0.52, 0.07, 0.12
"""The collarette, the border between the iris's inner and outer zone: radius and width in iris radii, and how much
lighter it is in natural logarithms."""

VESSELS, VESSEL_WIDTH = 0.16, 0.09
"""Largest share of green and blue that blood vessels take from the sclera, and the noise value at which that has
fallen to 1/e: vessels follow the zeros of the noise."""


@dataclass(frozen=True)
class DrawnEye:
    """One eye on the map.

    Attributes:
        place: its texels; None for an eye on a picture of its own.
        radius: (N,) float32 angle from the line of sight over that of the limbus, of the texels inside.
        azimuth: (N,) float32 radians round the line of sight.
        direction: (N, 3) float32 unit vectors from the eyeball's centre.
        limbus: degrees from the line of sight to the limbus, the iris's rim.
        pupil: degrees from the line of sight to the pupil's rim.
        texel: side of a texel near the iris in iris radii.
    """

    place: PartTexels | None
    radius: Float32
    azimuth: Float32
    direction: Float32
    limbus: float
    pupil: float
    texel: float

    @classmethod
    def of(cls, place: PartTexels, pupil_m: float | None = None) -> DrawnEye | None:
        """With a pupil of a radius in metres; None where the map has no texel of its iris."""
        ball = Eyeball.of(place.vertices)
        ray = ball.rays(place.points)
        limbus = np.radians(ball.limbus_deg)
        radius = (np.arccos(np.clip(ray[:, 2], -1, 1)) / limbus).astype(np.float32)
        within = int((radius < 1).sum())
        if not within:
            return None
        azimuth, texel = np.arctan2(ray[:, 1], ray[:, 0]).astype(np.float32), float(np.sqrt(np.pi / within))
        pupil = ball.pupil_deg(pupil_m)
        return cls(place, radius, azimuth, ray.astype(np.float32), ball.limbus_deg, pupil, texel)


def eyeballs(head: HeadModel, size: tuple[int, int], pupil_m: float | None = None) -> list[DrawnEye]:
    """The eyes of a head on its chart at a size (width, height); an imported head may have none."""
    places = (PartTexels.of(head, name, size) for name in head.part_names if name.startswith("eye"))
    found = (DrawnEye.of(place, pupil_m) for place in places if place is not None)
    return [eye for eye in found if eye is not None]


def draw_eyes(
    albedo: Codes, head: HeadModel, detail: float = 1.0, iris_albedo: AnyFloat | None = None,
    pupil_m: float | None = None,
) -> Codes:  # fmt: skip
    """The albedo, changed in place: eyes drawn at its full resolution.

    Args:
        albedo: (H, W, 3) codes of sRGB.
        head: whose chart it is; without eyes, or with too few texels of them, the albedo stays as it is.
        detail: strength in [0, 1] of fibres and vessels, which are synthetic and seeded by the iris's colour.
        iris_albedo: (3,) linear; None: read off the albedo.
        pupil_m: radius of the pupils, metres; None: that of a lit room.
    """
    eyes = eyeballs(head, (albedo.shape[1], albedo.shape[0]), pupil_m)
    if sum(int((eye.radius < RING[1]).sum()) for eye in eyes) < LEAST_TEXELS:
        return albedo
    iris = _iris_on_map(albedo, eyes) if iris_albedo is None else np.asarray(iris_albedo, np.float32)
    for eye in eyes:
        if eye.place is not None:
            drawn = np.rint(np.clip(linear_to_srgb(eye_albedo(eye, iris, detail)), 0, 1) * FULL_CODE)
            albedo[eye.place.box][eye.place.inside] = drawn.astype(albedo.dtype)
    return albedo


def eye_albedo(eye: DrawnEye, iris: Float32, detail: float = 1.0) -> Float32:
    """(N, 3) linear albedo of an eye.

    Args:
        eye: where its texels lie.
        iris: (3,) linear albedo.
        detail: strength in [0, 1] of fibres and vessels.
    """
    # The same seed for both eyes: a person's are alike.
    random = np.random.default_rng(np.rint(linear_to_srgb(iris) * 255).astype(int))
    painted = paint_eye(eye.radius * eye.limbus, eye.limbus, eye.pupil, iris)
    linear = srgb_to_linear(painted) * _fibres(eye, random)[:, None] ** np.float32(detail)
    linear[:, 1:] *= 1 - np.float32(detail) * _vessels(eye, random)[:, None]
    return np.asarray(np.clip(linear, 0, BRIGHTEST), np.float32)


def _iris_on_map(albedo: Codes, eyes: list[DrawnEye]) -> Float32:
    """(3,) linear median colour of the irises on a map; ``IRIS`` where they have too few texels."""
    chosen = [albedo[e.place.box][e.place.inside][(e.radius > RING[0]) & (e.radius < RING[1])]
              for e in eyes if e.place is not None]  # fmt: skip
    codes = np.concatenate(chosen)
    return likely_iris(srgb_to_linear(np.median(codes, 0) / FULL_CODE)) if len(codes) >= LEAST_TEXELS else IRIS


def _fibres(eye: DrawnEye, random: np.random.Generator) -> Float32:
    """(N,) factor on the iris's colour: fibres and collarette; 1 on pupil and sclera."""
    # Most periods of a cosine round the iris; fewer where a texel does not resolve them.
    finest = min(70.0, np.pi * RING[0] / max(eye.texel, 1e-6))
    periods = np.rint(np.exp(random.uniform(np.log(3), np.log(max(finest, 4)), FIBRES)))
    phases, bends = random.uniform(0, 2 * np.pi, FIBRES), random.normal(0, 1.5, FIBRES)
    fades = random.uniform(0, 2 * np.pi, FIBRES)
    r, noise = eye.radius, np.zeros(len(eye.radius), np.float32)
    near = r < 1.2
    azimuth, inner, total = eye.azimuth[near], r[near], noise[near]
    # Plain numbers: scalars of numpy would make all of it float64.
    for n, phase, bend, fade in np.stack([periods, phases, bends, fades], 1).tolist():
        total += np.cos(n * azimuth + phase + bend * inner) * (1 + 0.6 * np.cos(6 * inner + fade))
    noise[near] = total
    wavy = COLLARETTE + 0.03 * np.cos(5 * eye.azimuth + phases[0]) + 0.02 * np.cos(11 * eye.azimuth + phases[1])
    collarette = COLLARETTE_LIGHT * np.exp(-(((r - wavy) / COLLARETTE_WIDTH) ** 2))
    rim = smoothstep(r, 1.05, 0.9) * smoothstep(r / (eye.pupil / eye.limbus), 0.95, 1.15)
    factor = np.exp(FIBRE_DEPTH * np.sqrt(2 / FIBRES) * noise + collarette)
    return np.asarray(1 + rim * (factor - 1), np.float32)


def _vessels(eye: DrawnEye, random: np.random.Generator) -> Float32:
    """(N,) share of green and blue that vessels take: zeros of a noise, stronger towards the corners of the lids."""
    share = np.asarray(VESSELS * smoothstep(eye.radius, 1.2, 2.6), np.float32)
    white = np.flatnonzero(share)
    direction, noise = eye.direction[white], np.zeros(len(white), np.float32)
    for scale in (5.0, 9.0, 16.0, 30.0):
        axes, phases = random.normal(0, scale, (6, 3)).astype(np.float32), random.uniform(0, 2 * np.pi, 6)
        noise += np.cos(direction @ axes.T + phases.astype(np.float32)).sum(1) / np.float32(6)
    share[white] *= np.exp(-((noise / np.float32(VESSEL_WIDTH)) ** 2))
    return share
