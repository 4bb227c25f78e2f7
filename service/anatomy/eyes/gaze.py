"""Where the eyes look: the direction in which both irises together are likeliest, and eyes that are turned to it.

One eye alone errs by the shade of a lid, a lamp it mirrors, a strand of hair. Both look nearly the same way, and what
misleads one is elsewhere in the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.anatomy.eyes.eyeball import IRIS_RADIUS_M, SIDES, Eyeball, eyeball
from service.anatomy.eyes.iris import Iris, Search, search
from service.geometry.camera import Camera
from service.head.model import HeadModel
from service.head.regions import part_vertices

Array = npt.NDArray[np.float64]

RIMS = {
    "left": (263, 249, 390, 373, 374, 380, 381, 382, 362, 398, 384, 385, 386, 387, 388, 466),
    "right": (33, 7, 163, 144, 145, 153, 154, 155, 133, 173, 157, 158, 159, 160, 161, 246),
}
"""Landmarks round the opening between the lids, of the subject's left and right eye."""
LIDS = ("eyeBlink", "eyeSquint", "eyeWide")
"""Units that give the lids back what the units of the gaze take from them."""

APART = 0.5
"""Radii of the iris by which one may lie beside where the common direction has it: eyes converge, fits err."""
STEP_DEG = 2.0
"""Of the directions that are tried."""
WIDEST = np.array([38.0, 28.0])
"""Degrees beyond which no one looks without turning the head."""


@dataclass(frozen=True)
class Gaze:
    """Direction of both eyes in the head's frame.

    Attributes:
        yaw_deg: > 0 to the subject's left.
        pitch_deg: > 0 upwards.
        irises: those it was read from, 0 to 2; with none the direction is straight ahead and assumed.
    """

    yaw_deg: float
    pitch_deg: float
    irises: tuple[Iris, ...] = ()


def find_gaze(
    pixels: npt.NDArray[np.uint8],
    landmarks: npt.NDArray[np.floating],
    head: HeadModel,
    neutral: npt.NDArray[np.floating],
    camera: Camera,
) -> Gaze | None:
    """Gaze of a fitted head.

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        landmarks: (468, >= 2) photo pixels; eyes with one that is not finite are left out.
        head: the head model.
        neutral: (V, 3) metres, the head with its eyes straight ahead.
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
    seen: list[tuple[Iris, Array]] = []
    for found, ball in eyes:
        iris = found.best(camera.project((ball.centre + ball.radius * direction)[None])[0], APART)
        if iris is None:
            continue
        angles = _angles(camera, ball, iris.centre)
        if (np.abs(angles) < WIDEST).all():
            seen.append((iris, angles))
    if not seen:
        return Gaze(0.0, 0.0)
    weight = np.array([iris.contrast for iris, _ in seen])
    yaw, pitch = weight @ np.stack([angles for _, angles in seen]) / weight.sum()
    return Gaze(float(yaw), float(pitch), tuple(iris for iris, _ in seen))


def _common_direction(eyes: list[tuple[Search, Eyeball]], camera: Camera) -> Array:
    """(3,) unit vector in the head's frame along which the eyes together look likeliest."""
    import cv2

    yaw, pitch = (np.radians(np.arange(-most, most + 1e-6, STEP_DEG)) for most in WIDEST)
    x, y = (part.ravel() for part in np.meshgrid(yaw, pitch))
    directions = np.stack([np.sin(x) * np.cos(y), np.sin(y), np.cos(x) * np.cos(y)], 1)
    total = np.zeros(len(directions))
    for found, ball in eyes:
        at = found.to_patch(camera.project(ball.centre + ball.radius * directions)).astype(np.float32)
        likely = found.spread(APART)
        total += cv2.remap(likely, at[:, :1], at[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)[:, 0]
    return np.asarray(directions[int(np.argmax(total))])


def _iris_px(camera: Camera, centre: Array) -> float:
    depth = float(camera.to_camera(centre[None])[0, 2])
    return IRIS_RADIUS_M * camera.focal_px / depth if depth > 0 else 0.0


def _angles(camera: Camera, ball: Eyeball, pixel: Array) -> Array:
    """(2,) yaw and pitch in degrees of the eye whose iris is seen at a pixel: where its ray meets the eyeball."""
    middle = camera.to_camera(ball.centre[None])[0]
    ray = np.append((pixel - camera.principal_point) / camera.focal_px, 1.0)
    ray /= np.linalg.norm(ray)
    along = float(ray @ middle)
    # A ray that passes beside the ball counts as touching its rim.
    inside = max(ball.radius**2 - (float(middle @ middle) - along**2), 0.0)
    x, y, z = ((along - np.sqrt(inside)) * ray - middle) @ camera.rotation
    return np.asarray(np.degrees([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))]))


def with_gaze(head: HeadModel, neutral: npt.NDArray[np.floating], expression: Array, gaze: Gaze) -> Array:
    """(E,) expression whose eyes look along a gaze and whose lids stay where they were, all in [0, 1].

    Args:
        head: the model; sides without the units ``eyeLook*`` keep theirs.
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
        own = part_vertices(head, f"eye_{side}")
        pole = int(own[np.argmax(head.mean[own, 2])])
        yaw, pitch = np.radians([gaze.yaw_deg, gaze.pitch_deg])
        leftward = outward if side == "left" else inward
        rightward = inward if side == "left" else outward
        for wanted, axis, (plus, minus) in (
            (ball.radius * np.tan(yaw), 0, (leftward, rightward)),
            (ball.radius * np.tan(pitch) / np.cos(yaw), 1, (up, down)),
        ):
            unit = plus if wanted > 0 else minus
            step = abs(float(head.expression[unit, pole, axis]))
            out[unit] = min(abs(wanted) / step, 1.0) if step > 1e-5 else 0.0
        _keep_lids(head, side, expression, out)
    return out


def _keep_lids(head: HeadModel, side: str, before: Array, after: Array) -> None:
    """Change the lid units of ``after`` in place so that the lids move as little as they can."""
    from scipy.optimize import lsq_linear

    region = f"eyelid_{side}"
    units = [k for k, name in enumerate(head.expression_names) if name in {f"{u}{side.capitalize()}" for u in LIDS}]
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
