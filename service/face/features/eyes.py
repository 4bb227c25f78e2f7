"""Place, gaze and lids of the eyes, fitted to the photo after pose and shape are known.

Place: a fit places an eye to a millimetre or two. Left there, the iris of the photo lies beside that of the head: eyes
look down that do not, and the lids, which the gaze takes along, cannot be opened as far as the photo's are.

Gaze: the direction in which both irises together are likeliest, and the expression that turns the eyes there. In one
eye alone, a lid's shade, a mirrored lamp or a strand of hair can be mistaken for the iris. Both eyes look in nearly the
same direction, and such a mistake would lie elsewhere in the other eye.

Lids: the landmark fit places a lid to two millimetres only, and the model's lid openings are narrower than people's:
without more, an iris that the photo shows would be painted on a lid, and the lashes above it. So the edge of each lid,
as the camera sees it, is brought to the rim that the landmark network found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.arrays import AnyFloat, Float32, Float64, UInt8
from service.face.features.iris import Iris, Search, search
from service.face.features.rims import RIMS, Followed, Rim, fit_to_rim
from service.geometry.camera import Camera
from service.geometry.nearest import Nearest
from service.head.model import HeadModel
from service.head.regions import IRIS_RADIUS_M, SIDES, Eyeball, eyeball, lid_edges, part_vertices, pole
from service.robust import smoothstep

LID_UNITS = ("eyeBlink", "eyeSquint", "eyeWide")
"""Expression units of the lids."""

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
    """

    yaw_deg: float
    pitch_deg: float
    irises: tuple[Iris, ...] = ()


def find_gaze(pixels: UInt8, landmarks: AnyFloat, head: HeadModel, neutral: AnyFloat, camera: Camera) -> Gaze | None:
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
        depth = float(camera.to_camera(ball.centre[None])[0, 2])
        found = search(pixels, rim, IRIS_RADIUS_M * camera.focal_px / depth if depth > 0 else 0.0)
        if found is not None:
            eyes.append((found, ball))
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
    return Gaze(float(yaw), float(pitch), tuple(iris for iris, _ in seen))


def _common_direction(eyes: list[tuple[Search, Eyeball]], camera: Camera) -> Float64:
    """(3,) unit vector in the head's frame with the largest merit, summed over the eyes; any without eyes."""
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
    """(E,) expression, all in [0, 1], whose eyes look along a gaze; :func:`lids_on_rims` sets the lids anew.

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
    return out


LASH_ROOTS = 0.007
"""Height of the landmark network's upper rim, which lies on the roots of the lashes, above the opening, as a share of
the eye's length."""

SHUT = 0.03
"""Opening of a rim that lies on the edges of the lids, as a share of its length, below which the eye is closed: what
the network is off by on closed eyes."""


@dataclass(frozen=True)
class SeenRims:
    """Rims of one photo, and the head in it.

    Attributes:
        expression: (E,) activations fitted to the landmarks.
        camera: of the fit.
        landmarks: (468, >= 2) photo pixels.
        exact: openings whose rims lie on the edges of lids and lips.
    """

    expression: Float64
    camera: Camera
    landmarks: Float64
    exact: frozenset[str]


def lids_on_rims(head: HeadModel, neutral: AnyFloat, seen: SeenRims) -> Float64:
    """(E,) expression, all in [0, 1], whose lids end at the rims of the photo's eyes.

    Args:
        head: the model; eyes without lids, lid units or a legible rim keep their activations.
        neutral: (V, 3) metres, the fitted head without expression.
        seen: rims of the photo; where they do not lie on the edges of the lids, upper ones lie on the roots of lashes.
    """
    for side in SIDES:
        seen = replace(seen, expression=lid_on_rim(head, neutral, seen, side)[1].expression)
    return np.array(seen.expression, np.float64)


def lid_on_rim(
    head: HeadModel, neutral: AnyFloat, seen: SeenRims, side: str, *, placed: bool = True
) -> tuple[Rim | None, Followed]:
    """One eye's rim, None where it is not legible, and how the lids follow it; ``placed``: the eye lies right."""
    edges, points = lid_edges(head, side), np.asarray(seen.landmarks, np.float64)[list(RIMS[side]), :2]
    # Part of the way from the outer corner to the inner over which lids are fitted: there the model's eyes are open;
    # people's openings are a little longer.
    rim = Rim.of(points, seen.camera.rotation[:2, 1], (0.08, 0.92))
    if edges is None or rim is None:
        return None, Followed(np.array(seen.expression, np.float64))
    names, start = {f"{unit}{side.capitalize()}" for unit in LID_UNITS}, np.array(seen.expression, np.float64)
    if side not in seen.exact:
        lower = replace(rim, upper=rim.upper - [0.0, LASH_ROOTS * rim.length])
        return rim, fit_to_rim(lower, edges, names, head, neutral, start, seen.camera)
    if rim.gap < SHUT:
        # Lids that meet in this view may be apart in others: only where they meet is fitted.
        rim, start, names = rim.narrower(rim.length), _shut(head, start, side), {f"eyeSquint{side.capitalize()}"}
    return rim, fit_to_rim(rim, edges, names, head, neutral, start, seen.camera, placed=placed)


def eyes_at_rest(head: HeadModel, expression: Float64) -> Float64:
    """(E,) the expression with eyes as in the neutral face: behind dark glasses nothing is known of lids and gaze."""
    return np.where([name.startswith("eye") for name in head.expression_names], 0, expression)


def _shut(head: HeadModel, expression: Float64, side: str) -> Float64:
    """(E,) the expression with one eye closed, whose lids no gaze takes along."""
    out = np.array(expression, np.float64)
    place = {name: k for k, name in enumerate(head.expression_names)}
    for unit in ("eyeBlink", "eyeWide", "eyeLookUp", "eyeLookDown"):
        if (name := f"{unit}{side.capitalize()}") in place:
            out[place[name]] = float(unit == "eyeBlink")
    return out


FADES_M = 0.018
"""Distance from lids and eyeball over which the skin around them follows less and less."""


def eyes_on_rims(head: HeadModel, neutral: AnyFloat, photos: Sequence[SeenRims]) -> Float32:
    """(V, 3) float32 metres: the head whose eyes lie at the height and tilt of the rims that were read.

    Photos count by how squarely they show the face.

    Args:
        head: the model; an eye without lids stays where it is.
        neutral: (V, 3) metres, the fitted head without expression.
        photos: with sides among ``exact`` whose rims are followed; other eyes stay.
    """
    out = np.array(neutral, np.float32)
    for side in SIDES:
        moves, weights = [], []
        for seen in photos:
            if side not in seen.exact:
                continue
            rim, found = lid_on_rim(head, neutral, seen, side, placed=False)
            if rim is not None:
                moves.append(_moved(head, np.asarray(neutral, np.float64), seen.camera, side, rim, found))
                weights.append(max(-float(seen.camera.rotation[2, 2]), 0.05) ** 2)
        shares = np.asarray(weights, np.float64) / max(sum(weights), 1e-9)
        for share, move in zip(shares, moves, strict=True):
            out += np.float32(share) * move
    return out


def _moved(head: HeadModel, neutral: Float64, camera: Camera, side: str, rim: Rim, found: Followed) -> Float32:
    """(V, 3) by how much each vertex moves: rigidly near the eye, turned about the direction of view."""
    lids = np.flatnonzero(head.region(f"eyelid_{side}") > 0.5)
    core = np.concatenate([lids, part_vertices(head, f"eye_{side}")])
    distance = Nearest(neutral[core]).one(neutral)[0]
    weight = smoothstep(distance, FADES_M, 0.0)
    up = rim.across @ camera.rotation[:2]
    along = rim.along * rim.length @ camera.rotation[:2]
    angle = np.arctan(found.tilt)
    offset = neutral - neutral[lids].mean(0)
    x, y = offset @ along, offset @ up
    turned_x = (np.cos(angle) - 1.0) * x - np.sin(angle) * y
    turned_y = np.sin(angle) * x + (np.cos(angle) - 1.0) * y
    moved = (turned_x + found.aside_m)[:, None] * along + (turned_y + found.raised_m)[:, None] * up
    return np.asarray(weight[:, None] * moved, np.float32)
