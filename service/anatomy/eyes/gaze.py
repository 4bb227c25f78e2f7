"""Gaze: the direction in which both irises together are likeliest, and the expression that turns the eyes there.

In one eye alone, a lid's shade, a mirrored lamp or a strand of hair can be mistaken for the iris. Both eyes look in
nearly the same direction, and such a mistake would lie elsewhere in the other eye.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.anatomy.eyes.eyeball import IRIS_RADIUS_M, SIDES, Eyeball, eyeball, pole
from service.anatomy.eyes.iris import Iris, Search, search
from service.anatomy.eyes.pupil import pupil_radius
from service.arrays import AnyFloat, Float64, UInt8
from service.geometry.camera import Camera
from service.head.model import HeadModel

RIMS = {
    "left": (263, 249, 390, 373, 374, 380, 381, 382, 362, 398, 384, 385, 386, 387, 388, 466),
    "right": (33, 7, 163, 144, 145, 153, 154, 155, 133, 173, 157, 158, 159, 160, 161, 246),
}
"""Landmarks round the lid opening of the subject's left and right eye: from the outer corner, lower lid first."""

LID_UNITS = ("eyeBlink", "eyeSquint", "eyeWide")
"""Expression units of the lids. They undo what the units ``eyeLook*`` do to the lids."""

MOST_OFFSET = 0.5
"""Largest distance, in iris radii, of an iris from its place in the common direction: eyes converge, fits err."""

STEP_DEG = 2.0
"""Step between the directions that are tried, degrees."""

MOST_ANGLE_DEG = np.array([38.0, 28.0])
"""Largest yaw and pitch of the eyes, degrees; to look further people turn the head."""


@dataclass(frozen=True)
class Gaze:
    """Direction of both eyes in the head's frame.

    Attributes:
        yaw_deg: > 0 to the subject's left.
        pitch_deg: > 0 upwards.
        irises: those it was measured on, 0 to 2; with none the gaze is assumed to be straight ahead.
        pupil_m: radius of the pupils, metres; None where the photo does not tell.
    """

    yaw_deg: float
    pitch_deg: float
    irises: tuple[Iris, ...] = ()
    pupil_m: float | None = None


def find_gaze(
    pixels: UInt8,
    landmarks: AnyFloat,
    head: HeadModel,
    neutral: AnyFloat,
    camera: Camera,
) -> Gaze | None:
    """Gaze of a fitted head.

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        landmarks: (468, >= 2) photo pixels; an eye with one that is not finite is left out.
        head: the head model.
        neutral: (V, 3) metres, the head looking straight ahead.
        camera: of the fit.

    Returns:
        The gaze; None for a head without eyeballs.
    """
    eyes: list[tuple[Search, Eyeball]] = []
    for side in SIDES:
        ball = eyeball(head, neutral, side)
        if ball is None:
            return None
        rim = np.asarray(landmarks, np.float64)[list(RIMS[side]), :2]
        found = search(pixels, rim, _iris_px(camera, ball.centre))
        if found is not None:
            eyes.append((found, ball))
    if not eyes:
        return Gaze(0.0, 0.0)
    direction = _common_direction(eyes, camera)
    seen: list[tuple[Iris, Float64]] = []
    for found, ball in eyes:
        iris = found.best(camera.project((ball.centre + ball.radius * direction)[None])[0], MOST_OFFSET)
        if iris is None:
            continue
        angles = _angles(camera, ball, iris.centre)
        if (np.abs(angles) < MOST_ANGLE_DEG).all():
            seen.append((iris, angles))
    if not seen:
        return Gaze(0.0, 0.0)
    weight = np.array([iris.contrast for iris, _ in seen])
    yaw, pitch = weight @ np.stack([angles for _, angles in seen]) / weight.sum()
    irises = tuple(iris for iris, _ in seen)
    return Gaze(float(yaw), float(pitch), irises, pupil_radius(pixels, irises))


def _common_direction(eyes: list[tuple[Search, Eyeball]], camera: Camera) -> Float64:
    """(3,) unit vector in the head's frame with the largest merit, summed over the eyes."""
    import cv2

    yaw, pitch = (np.radians(np.arange(-most, most + 1e-6, STEP_DEG)) for most in MOST_ANGLE_DEG)
    x, y = (part.ravel() for part in np.meshgrid(yaw, pitch))
    directions = np.stack([np.sin(x) * np.cos(y), np.sin(y), np.cos(x) * np.cos(y)], 1)
    total = np.zeros(len(directions))
    for found, ball in eyes:
        at = found.to_patch(camera.project(ball.centre + ball.radius * directions)).astype(np.float32)
        likely = found.spread(MOST_OFFSET)
        total += cv2.remap(likely, at[:, :1], at[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)[:, 0]
    return np.asarray(directions[int(np.argmax(total))])


def _iris_px(camera: Camera, centre: Float64) -> float:
    """Radius of an iris in photo pixels; 0 behind the camera."""
    depth = float(camera.to_camera(centre[None])[0, 2])
    return IRIS_RADIUS_M * camera.focal_px / depth if depth > 0 else 0.0


def _angles(camera: Camera, ball: Eyeball, pixel: Float64) -> Float64:
    """(2,) yaw and pitch in degrees of an eye whose iris is seen at a pixel, whose ray is cut with the eyeball."""
    middle = camera.to_camera(ball.centre[None])[0]
    ray = np.append((pixel - camera.principal_point) / camera.focal_px, 1.0)
    ray /= np.linalg.norm(ray)
    along = float(ray @ middle)
    # A ray that misses the eyeball counts as a tangent.
    half_chord_squared = max(ball.radius**2 - (float(middle @ middle) - along**2), 0.0)
    x, y, z = ((along - np.sqrt(half_chord_squared)) * ray - middle) @ camera.rotation
    return np.asarray(np.degrees([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))]))


def with_gaze(head: HeadModel, neutral: AnyFloat, expression: Float64, gaze: Gaze) -> Float64:
    """(E,) expression, all in [0, 1], whose eyes look along a gaze while the lids stay where they were.

    Args:
        head: the model; an eye without eyeball or without the units ``eyeLook*`` keeps its activations.
        neutral: (V, 3) metres.
        expression: (E,) activations.
        gaze: direction wanted.
    """
    out = np.array(expression, np.float64)
    index = {name: k for k, name in enumerate(head.expression_names)}
    for side in SIDES:
        names = [f"eyeLook{way}{side.capitalize()}" for way in ("In", "Out", "Up", "Down")]
        ball = eyeball(head, neutral, side)
        if ball is None or any(name not in index for name in names):
            continue
        inward, outward, up, down = (index[name] for name in names)
        out[[inward, outward, up, down]] = 0.0
        ahead = pole(head, side)
        yaw, pitch = np.radians([gaze.yaw_deg, gaze.pitch_deg])
        leftward = outward if side == "left" else inward
        rightward = inward if side == "left" else outward
        for wanted, axis, (plus, minus) in (
            (ball.radius * np.tan(yaw), 0, (leftward, rightward)),
            (ball.radius * np.tan(pitch) / np.cos(yaw), 1, (up, down)),
        ):
            unit = plus if wanted > 0 else minus
            step = abs(float(head.expression[unit, ahead, axis]))
            out[unit] = min(abs(wanted) / step, 1.0) if step > 1e-5 else 0.0
        _keep_lids(head, side, expression, out)
    return out


def _keep_lids(head: HeadModel, side: str, before: Float64, after: Float64) -> None:
    """Change the lid units of ``after`` in place so that the lids move least, by bounded least squares."""
    from scipy.optimize import lsq_linear

    region = f"eyelid_{side}"
    names = {f"{unit}{side.capitalize()}" for unit in LID_UNITS}
    units = [k for k, name in enumerate(head.expression_names) if name in names]
    if region not in head.region_names or not units:
        return
    lids = np.flatnonzero(head.region(region) > 0.5)
    if not len(lids):
        return
    moved = np.tensordot(before - after, head.expression[:, lids].astype(np.float64), 1).ravel()
    basis = head.expression[units][:, lids].reshape(len(units), -1).T.astype(np.float64)
    ridge = 0.1 * np.linalg.norm(basis, axis=0).max() * np.eye(len(units))
    low, high = -before[units], 1.0 - before[units]
    solved = lsq_linear(np.vstack([basis, ridge]), np.r_[moved, np.zeros(len(units))], (low - 1e-9, high + 1e-9))
    after[units] = np.clip(before[units] + solved.x, 0.0, 1.0)
