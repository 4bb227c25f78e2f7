"""Eyes, teeth, tongue, lashes and mouth: painted in plausible colours where the photo does not show them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.colour import luma
from service.geometry.chart import Chart

Float = npt.NDArray[np.float32]

IRIS_RADIUS_M = 0.00585
PUPIL_RADIUS_M = 0.0019

SCLERA = np.array([0.80, 0.77, 0.75], np.float32)
IRIS = np.array([0.34, 0.25, 0.19], np.float32)
SOCKET = np.array([0.62, 0.38, 0.35], np.float32)
TEETH = np.array([0.78, 0.73, 0.65], np.float32)
TONGUE = np.array([0.50, 0.27, 0.26], np.float32)
MOUTH = np.array([0.33, 0.13, 0.12], np.float32)
LASHES = np.array([0.12, 0.09, 0.08], np.float32)
"""sRGB colours under the light under which a sclera looks like ``SCLERA``; those in the mouth are in its shade."""

LEAST_SAMPLES = 12


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


@dataclass(frozen=True)
class EyeTone:
    """Colours measured on both eyes: (3,) sRGB each, None where too little of it was seen."""

    sclera: Float | None
    iris: Float | None


def measure_eyes(chart: Chart, colour: Float, weight: Float) -> EyeTone:
    """Median iris and bright, pale sclera of the eye texels (N,) that the photo shows."""
    white, dark = [], []
    for name in ("eye_left", "eye_right"):
        if name not in chart.head.part_names:
            continue
        texels, angle, limbus, pupil = eye_angles(chart, chart.head.part_names.index(name))
        seen, shown = weight[texels] > 0.2, colour[texels]
        dark.append(shown[seen & (angle > 1.2 * pupil) & (angle < 0.85 * limbus)])
        white.append(shown[seen & (angle > 1.25 * limbus) & (angle < 2.2 * limbus)])
    return EyeTone(_pale(np.concatenate(white or [np.zeros((0, 3), np.float32)])), _middle(dark))


def _pale(colours: Float) -> Float | None:
    """Mean of the brighter third, which leaves out lids, lashes and shadow; None if it is not pale at all."""
    if len(colours) < LEAST_SAMPLES:
        return None
    order = np.argsort(luma(colours), kind="stable")
    bright = colours[order[2 * len(order) // 3 :]].mean(0)
    saturation = float(bright.max() - bright.min()) / max(float(bright.max()), 1e-3)
    return bright.astype(np.float32) if saturation < 0.4 and bright.max() > 0.2 else None


def _middle(groups: list[Float]) -> Float | None:
    colours = np.concatenate(groups or [np.zeros((0, 3), np.float32)])
    return np.median(colours, 0).astype(np.float32) if len(colours) >= LEAST_SAMPLES else None


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
