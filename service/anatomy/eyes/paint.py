"""The photo's light, and eyes: painted in the colours that the photo shows of them, else in plausible ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.colour import luma
from service.geometry.chart import Chart

Float = npt.NDArray[np.float32]
Array = npt.NDArray[np.float64]

IRIS_RADIUS_M = 0.00585
PUPIL_RADIUS_M = 0.0019

BRIGHTEST = 0.85
"""Largest albedo of an eye or a tooth."""

SCLERA = np.array([0.80, 0.77, 0.75], np.float32)
IRIS = np.array([0.34, 0.25, 0.19], np.float32)
SOCKET = np.array([0.62, 0.38, 0.35], np.float32)
LASHES = np.array([0.12, 0.09, 0.08], np.float32)
"""sRGB colours under the light under which a sclera looks like ``SCLERA``."""

BETWEEN = 0.7
"""What the lids leave of the light on the flesh between them and the eyeball, on sRGB values."""

LID_SHADE = ((-0.55, 0.75), (-0.30, 0.95), (-0.05, 1.0), (0.10, 0.87), (0.23, 0.55), (0.6, 0.4))
"""Height on the eyeball over its radius, and how much light the lids leave there (on sRGB values). In the texture,
which is the photo's; the albedo is without."""
CORNER_SHADE = ((0.45, 1.0), (0.85, 0.75))
"""The same sideways, towards the corners of the lids."""
ALIKE = 0.45
"""RGB distance between photo and paint at which the photo counts for a third: far more is skin or a mirrored lamp."""


@dataclass(frozen=True)
class Light:
    """How white things look in this photo: gain (3,) float32 on sRGB values, and how colourful it is in [0, 1]."""

    gain: Float
    colourfulness: float

    def on(self, colour: Float) -> Float:
        """A colour (..., 3) given in sRGB under standard light, as this photo would show it."""
        lit = np.clip(colour * self.gain, 0.0, 1.0)
        grey = luma(lit)[..., None]
        return np.asarray(grey + np.float32(self.colourfulness) * (lit - grey), np.float32)


def judge_light(sclera: Float | None, skin: Float | None, face_colours: Float) -> Light:
    """Gain from the white of the eyes where it was seen, else from the bright end of the face.

    Args:
        sclera: (3,) sRGB or None.
        skin: (3,) sRGB median skin or None.
        face_colours: (N, 3) sRGB texels of the face, may be empty.
    """
    if sclera is not None:
        gain = sclera / SCLERA
    elif len(face_colours):
        bright = np.percentile(luma(face_colours), 95)
        gain = np.full(3, np.clip(bright / 0.8, 0.35, 1.15))
    else:
        gain = np.ones(3)
    colourful = 1.0 if skin is None else float(np.clip((skin.max() - skin.min()) / 0.06, 0.0, 1.0))
    return Light(np.asarray(gain, np.float32), colourful)


def eye_angles(chart: Chart, part: int) -> tuple[npt.NDArray[np.int64], Float, float, float]:
    """Angle of an eye's texels from its line of sight in the neutral mean head.

    Returns:
        (n,) positions of the eye's texels among the inner ones, (n,) float32 degrees, and the angles of limbus and
        pupil in degrees.
    """
    head = chart.head
    texels = np.flatnonzero(chart.inner_part == part)
    own = np.unique(head.triangles[head.triangle_part == part])
    low, high = head.mean[own].min(0), head.mean[own].max(0)
    radius = max(float((high - low).max()) / 2, 1e-6)
    ray = np.einsum("nk,nki->ni", chart.weights[texels], head.mean[chart.corners[texels]] - (low + high) / 2)
    cosine = ray[:, 2] / np.maximum(np.sqrt((ray * ray).sum(1)), 1e-9)
    limbus, pupil = (np.degrees(np.arcsin(min(r / radius, 0.9))) for r in (IRIS_RADIUS_M, PUPIL_RADIUS_M))
    return texels, np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).astype(np.float32), float(limbus), float(pupil)


def lid_shade(chart: Chart, part: int) -> Float:
    """(n, 1) light that the lids leave to an eye's texels, in the order of :func:`eye_angles`."""
    head = chart.head
    texels = np.flatnonzero(chart.inner_part == part)
    own = head.mean[np.unique(head.triangles[head.triangle_part == part])]
    low, high = own.min(0), own.max(0)
    points = np.einsum("nk,nki->ni", chart.weights[texels], head.mean[chart.corners[texels]]) - (low + high) / 2
    x, y, _ = points.T / max(float((high - low).max()) / 2, 1e-6)
    lids, corners = np.array(LID_SHADE).T, np.array(CORNER_SHADE).T
    light = np.interp(y, *lids) * np.interp(np.abs(x), *corners)
    return np.asarray(light, np.float32)[:, None]


def eye_shade(chart: Chart) -> Float:
    """(H, W) light that the lids leave to the eyes, :func:`lid_shade` on all of them, and 1 everywhere else."""
    factor = np.ones(len(chart.texels), np.float32)
    for index, name in enumerate(chart.head.part_names):
        if name.startswith("eye"):
            factor[chart.inner_part == index] = lid_shade(chart, index)[:, 0]
    return chart.fill_outside(chart.spread(factor[:, None])[..., 0])


def alike(seen: Float, painted: Float) -> Float:
    """(n,) in [0, 1] how well colours (n, 3) of the photo agree with the painted ones."""
    distance = ((seen - painted) ** 2).sum(1)
    return np.asarray(np.exp(-distance / ALIKE**2), np.float32)


def _blend(value: Float, low: float, high: float) -> Float:
    """Smoothstep of (N,) as (N, 1)."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return np.asarray((t * t * (3 - 2 * t))[:, None], np.float32)


def paint_eye(angle: Float, limbus: float, pupil: float, sclera: Float, iris: Float, socket: Float) -> Float:
    """(N, 3) sRGB of an eyeball by the angle (N,) in degrees from its line of sight.

    Pupil, iris with a dark rim, sclera that reddens towards the socket.
    """
    colour = np.broadcast_to(iris, (len(angle), 3)) * (1 + 0.25 * _blend(angle, 0.9 * limbus, 0.4 * limbus))
    colour = colour * (1 - 0.45 * _blend(angle, 0.82 * limbus, limbus))
    colour = colour * (1 - 0.85 * _blend(angle, 1.15 * pupil, 0.9 * pupil))
    white = sclera + (socket - sclera) * (0.9 * _blend(angle, 1.6 * limbus, 4.0 * limbus))
    return np.asarray(np.clip(colour + (white - colour) * _blend(angle, 0.94 * limbus, 1.1 * limbus), 0, 1), np.float32)
