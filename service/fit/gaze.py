"""Where the eyes look: the iris is sought inside the lids, and both eyes are turned the same way.

The landmark network gives the rim of the lids only. Inside it the iris is the disc of known size (11.7 mm in every
adult) that is darkest against its surroundings in red, where blue irises are as dark as brown ones and lids as bright
as sclera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.geometry.camera import Camera
from service.head.model import HeadModel

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]

IRIS_RADIUS_M = 0.00585
SIDES = ("left", "right")
RIMS = {
    "left": (263, 249, 390, 373, 374, 380, 381, 382, 362, 398, 384, 385, 386, 387, 388, 466),
    "right": (33, 7, 163, 144, 145, 153, 154, 155, 133, 173, 157, 158, 159, 160, 161, 246),
}
"""Landmarks round the opening between the lids, of the subject's left and right eye."""
LIDS = ("eyeBlink", "eyeSquint", "eyeWide")
"""Units that give the lids back what the units of the gaze take from them."""

RADIUS_PX = 12
"""Radius of the iris in the patch in which it is sought; REACH is the patch's half side in radii."""
REACH = 4
LEAST_RADIUS_PX = 2.0
"""Irises smaller than this in the photo are not to be told from lashes."""
RING = (1.1, 1.6)
LEAST_DISC, LEAST_RING = 0.35, 0.06
"""Share of disc and ring that has to lie between the lids."""
LEAST_CONTRAST = 0.22
"""Of ring and disc, as a share of the range of values between the lids."""
OFF_CENTRE = (0.02, 0.20)
"""Contrast that one radius away from the middle of the opening has to be worth: lids hide the iris above and below, so
its height is known less well."""
APART = np.array([14.0, 10.0])
"""Degrees of yaw and pitch in which two eyes may differ; one of them is wrong where they do more."""
WIDEST = np.array([38.0, 28.0])
"""Degrees beyond which no one looks without turning the head."""


@dataclass(frozen=True)
class Iris:
    """An iris in the photo.

    Attributes:
        centre: (2,) photo pixels.
        radius: photo pixels.
        rim: (16, 2) photo pixels round the opening between the lids, in order.
        contrast: how much darker it is than what surrounds it, in [0, 1].
    """

    centre: Array
    radius: float
    rim: Array
    contrast: float


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
    seen: list[tuple[Iris, Array]] = []
    for side in SIDES:
        ball = eyeball(head, neutral, side)
        if ball is None:
            return None
        centre, radius = ball
        rim = np.asarray(landmarks, np.float64)[list(RIMS[side]), :2]
        iris = find_iris(pixels, rim, _iris_px(camera, centre))
        if iris is None:
            continue
        angles = _angles(camera, centre, radius, iris.centre)
        if (np.abs(angles) < WIDEST).all():
            seen.append((iris, angles))
    if len(seen) == 2 and (np.abs(seen[0][1] - seen[1][1]) > APART).any():
        seen = [max(seen, key=lambda eye: eye[0].contrast)]
    if not seen:
        return Gaze(0.0, 0.0)
    weight = np.array([iris.contrast for iris, _ in seen])
    yaw, pitch = weight @ np.stack([angles for _, angles in seen]) / weight.sum()
    return Gaze(float(yaw), float(pitch), tuple(iris for iris, _ in seen))


def eyeball(head: HeadModel, vertices: npt.NDArray[np.floating], side: str) -> tuple[Array, float] | None:
    """Centre (3,) and radius in metres of an eyeball, or None where the head has none."""
    name = f"eye_{side}"
    if name not in head.part_names:
        return None
    corners = head.triangles[head.triangle_part == head.part_names.index(name)]
    if not len(corners):
        return None
    own = np.asarray(vertices, np.float64)[np.unique(corners)]
    low, high = own.min(0), own.max(0)
    radius = float((high - low).max()) / 2
    return ((low + high) / 2, radius) if radius > 1e-4 else None


def _iris_px(camera: Camera, centre: Array) -> float:
    depth = float(camera.to_camera(centre[None])[0, 2])
    return IRIS_RADIUS_M * camera.focal_px / depth if depth > 0 else 0.0


def _angles(camera: Camera, centre: Array, radius: float, pixel: Array) -> Array:
    """(2,) yaw and pitch in degrees of the eye whose iris is seen at a pixel: where its ray meets the eyeball."""
    middle = camera.to_camera(centre[None])[0]
    ray = np.append((pixel - camera.principal_point) / camera.focal_px, 1.0)
    ray /= np.linalg.norm(ray)
    along = float(ray @ middle)
    # A ray that passes beside the ball counts as touching its rim.
    inside = max(radius**2 - (float(middle @ middle) - along**2), 0.0)
    x, y, z = ((along - np.sqrt(inside)) * ray - middle) @ camera.rotation
    return np.asarray(np.degrees([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))]))


def find_iris(pixels: npt.NDArray[np.uint8], rim: Array, radius_px: float) -> Iris | None:
    """The iris of known size inside the lids.

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        rim: (N, 2) pixels round the opening between the lids, in order.
        radius_px: of the iris.

    Returns:
        None where the iris is too small, hidden, or not darker than what is around it.
    """
    import cv2

    if not np.isfinite(rim).all() or not radius_px >= LEAST_RADIUS_PX:
        return None
    half = RADIUS_PX * REACH
    scale = RADIUS_PX / radius_px
    middle = 0.5 * (rim.min(0) + rim.max(0))
    reach = (half + 1) / scale + 2
    if (middle < reach).any() or (middle > np.array(pixels.shape[1::-1]) - reach).any():
        return None
    corner = np.floor(middle - reach).astype(int)
    end = np.ceil(middle + reach).astype(int)
    near = cv2.GaussianBlur(pixels[corner[1] : end[1], corner[0] : end[0]], (0, 0), max(0.15 * radius_px, 0.3))
    # Pixel centres are at one half in the photo and at whole numbers in OpenCV and in the patch.
    at = middle - corner - 0.5
    matrix = np.array([[scale, 0, half - scale * at[0]], [0, scale, half - scale * at[1]]])
    size = (2 * half + 1, 2 * half + 1)
    patch = cv2.warpAffine(near, matrix, size)
    mask = np.zeros(size[::-1], np.uint8)
    corners = (rim - middle) * scale + half
    cv2.fillPoly(mask, [np.rint(corners * 16).astype(np.int32)], 1, shift=4)
    inside = mask > 0
    if inside.sum() < RADIUS_PX**2:
        return None
    red = patch[..., 0].astype(np.float32)
    low, high = np.percentile(red[inside], [3, 90])
    if high - low < 8:
        return None
    value = np.clip((red - low) / (high - low), 0.0, 1.0)
    score = _contrast(value, inside.astype(np.float32))
    y, x = np.indices(score.shape, np.float32)
    off = ((x - half) / RADIUS_PX) ** 2 * OFF_CENTRE[0] + ((y - half) / RADIUS_PX) ** 2 * OFF_CENTRE[1]
    row, column = np.unravel_index(int(np.argmax(np.where(inside, score - off, -np.inf))), score.shape)
    contrast = float(score[row, column])
    if not contrast > LEAST_CONTRAST:
        return None
    return Iris(middle + (np.array([column, row]) - half) / scale, radius_px, rim, min(contrast, 1.0))


def _contrast(value: Image, inside: Image) -> Image:
    """Mean of the ring less mean of the disc about each pixel, counting what is inside; -1 where that is too little."""
    import cv2

    reach = int(np.ceil(RING[1] * RADIUS_PX))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    distance = np.hypot(x, y) / RADIUS_PX
    means, enough = [], np.ones(value.shape, bool)
    for kernel, least in ((distance <= 0.95, LEAST_DISC), ((distance >= RING[0]) & (distance <= RING[1]), LEAST_RING)):
        k = kernel.astype(np.float32)
        count = cv2.filter2D(inside, cv2.CV_32F, k, borderType=cv2.BORDER_CONSTANT)
        total = cv2.filter2D(value * inside, cv2.CV_32F, k, borderType=cv2.BORDER_CONSTANT)
        means.append(total / np.maximum(count, 1.0))
        enough &= count >= least * k.sum()
    return np.where(enough, means[1] - means[0], np.float32(-1)).astype(np.float32)


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
        own = np.unique(head.triangles[head.triangle_part == head.part_names.index(f"eye_{side}")])
        pole = int(own[np.argmax(head.mean[own, 2])])
        yaw, pitch = np.radians([gaze.yaw_deg, gaze.pitch_deg])
        leftward = outward if side == "left" else inward
        rightward = inward if side == "left" else outward
        for wanted, axis, (plus, minus) in (
            (ball[1] * np.tan(yaw), 0, (leftward, rightward)),
            (ball[1] * np.tan(pitch) / np.cos(yaw), 1, (up, down)),
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
