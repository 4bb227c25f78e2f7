"""Eyes of one head as meshes of their own: ball with the iris set back, cornea, tear line and caruncle.

Ball and cornea are built about the head's own eyeballs and follow them affinely, so they turn with ``eyeLook*``; tear
line and caruncle follow the lids. Measures are those of adults: cornea of 7.8 mm radius (Gullstrand's eye), iris plane
at the limbus.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.anatomy.canvas import Canvas
from service.anatomy.eye_painting import DrawnEye, eye_albedo
from service.arrays import AnyFloat, Float32, Float64, Int32, Int64, UInt8
from service.face.features.eye_colours import IRIS
from service.face.fit.result import Fit
from service.head.eyeball import SIDES, Eyeball
from service.head.model import HeadModel
from service.head.regions import lid_edges, part_vertices
from service.materials.material import Material, OwnMap
from service.materials.part import Bone, MeshPart, targets_of

SIZE = 1024
"""Side of the picture of both eyes, texels."""
SEGMENTS = 48
"""Vertices of a ring about the line of sight."""
IRIS_SHARE, RIM_SHARE = 0.55, 0.98
"""Radius of the limbus, and of the back of the ball, on the picture, in halves of its side."""
BACK_DEG = 150.0
"""Angle from the line of sight at which the ball ends, out of sight."""
IRIS_BACK_M, PUPIL_BACK_M = 0.0004, 0.0006
"""Depth of the iris's inner edge behind the plane of the limbus, and of the pupil behind that."""
CORNEA_M = 0.0078
"""Radius of curvature of the cornea; its apex stands 1.1 mm before the sphere of the ball."""
FILM_M, FILM_DEG = 0.00004, 8.0
"""Height of the tear film over the sclera, and how far beyond the limbus it goes."""
TEAR_M = 0.0005
"""Height of the tear line on the ball, from the edge of the lid."""
CARUNCLE_M = (0.0017, 0.0013, 0.0013)
"""Half axes of the caruncle, across, up and forward."""
CARUNCLE_BACK_M, CARUNCLE_AT = 0.0009, 6
"""Its depth behind the inner corner, and the number of vertices of the lids' inner edge there that carry it."""
CARUNCLE = (0.50, 0.23, 0.20)
"""Diffuse albedo, linear RGB."""

def eye_parts(head: HeadModel, fit: Fit, iris: AnyFloat | None) -> tuple[MeshPart, ...]:
    """Both eyes; nothing for a head without two eyeballs.

    Args:
        head: topology, chart and units.
        fit: vertices of the head.
        iris: (3,) linear albedo of the irises; None: the most frequent.
    """
    if not all(len(part_vertices(head, f"eye_{side}")) for side in SIDES):
        return ()
    colour = IRIS if iris is None else np.asarray(iris, np.float32)
    pupil_m = None if fit.gaze is None else fit.gaze.pupil_m
    picture = OwnMap("eyes", eye_picture(head, colour, pupil_m))
    white = Material("eye", colour_map=picture, roughness=0.25, ior=1.4)
    clear = Material("eye_cornea", opacity=0.08, alpha="blend", roughness=0.03, ior=1.376, transmission=1.0)
    wet = Material("eye_tears", opacity=0.22, alpha="blend", roughness=0.02, ior=1.336, double_sided=True)
    flesh = Material("eye_caruncle", CARUNCLE, roughness=0.2, ior=1.4)
    made: list[MeshPart] = []
    for side in SIDES:
        bone: Bone = "eye_left" if side == "left" else "eye_right"
        own = part_vertices(head, f"eye_{side}")
        ball = Eyeball.of(head.mean[own].astype(np.float64))
        points, faces, places = globe(ball, pupil_m)
        name = f"eye_{side}"
        made.append(_on_ball(f"{name}_ball", head, fit, own, points, faces, places, white, bone, (name,)))
        points, faces = cornea(ball)
        made.append(_on_ball(f"{name}_cornea", head, fit, own, points, faces, places[: len(points)], clear, bone, ()))
        edges = lid_edges(head, side)
        if edges is not None:
            made.append(_tears(f"{name}_tears", head, fit, ball, edges.upper[0], edges.lower[0], wet))
            made.append(_caruncle(f"{name}_caruncle", head, fit, edges.upper[0], edges.lower[0], flesh))
    return tuple(made)


def globe(ball: Eyeball, pupil_m: float | None = None) -> tuple[Float64, Int32, Float32]:
    """(N, 3) metres, (F, 4) faces and (N, 2) places on the picture of a ball whose iris is a disc set back."""
    limbus, pupil = np.radians(ball.limbus_deg), np.radians(ball.pupil_deg(pupil_m))
    rim, hole = ball.radius * np.sin(limbus), ball.radius * np.sin(pupil)
    plane = ball.radius * np.cos(limbus)
    # Pupil, its edge, iris, then the sphere; radius and depth of every ring.
    rings = [(0.5 * hole, plane - IRIS_BACK_M - PUPIL_BACK_M), (hole, plane - IRIS_BACK_M - PUPIL_BACK_M)]
    for share in (0.0, 0.15, 0.4, 0.65, 0.85, 1.0):
        rings.append((hole + share * (rim - hole), plane - IRIS_BACK_M * (1 - share)))
    angles = np.concatenate([limbus + np.radians([3.0, 8.0, 14.0, 22.0]), np.radians(np.linspace(62, BACK_DEG, 8))])
    rings += [(ball.radius * np.sin(a), ball.radius * np.cos(a)) for a in angles]
    inner = len(rings) - len(angles)
    shares = [IRIS_SHARE * r / rim for r, _ in rings[:inner]] + [float(_share(a, limbus)) for a in angles]
    points, faces = _lathe(rings, front=plane - IRIS_BACK_M - PUPIL_BACK_M)
    turn = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    flat = np.array(shares)[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], -1)
    uv = 0.5 + 0.5 * np.concatenate([[[0.0, 0.0]], flat.reshape(-1, 2)])
    return points + ball.centre, faces, uv.astype(np.float32)


def cornea(ball: Eyeball) -> tuple[Float64, Int32]:
    """(N, 3) metres and (F, 4) faces of the cornea's dome, which runs out into the tear film on the sclera."""
    limbus = np.radians(ball.limbus_deg)
    rim, plane = ball.radius * np.sin(limbus), ball.radius * np.cos(limbus)
    # An eye too large for this curvature has a flatter cornea.
    curve = max(CORNEA_M, 1.15 * rim)
    foot = np.sqrt(curve**2 - rim**2)
    rings = []
    for share in (0.12, 0.3, 0.5, 0.7, 0.87, 1.0):
        rings.append((share * rim, plane + FILM_M + np.sqrt(curve**2 - (share * rim) ** 2) - foot))
    edge = limbus + np.radians(FILM_DEG)
    rings.append((ball.radius * np.sin(edge), ball.radius * np.cos(edge)))
    points, faces = _lathe(rings, front=plane + FILM_M + curve - foot)
    return points + ball.centre, faces


def eye_picture(head: HeadModel, iris: Float32, pupil_m: float | None = None) -> UInt8:
    """(SIZE, SIZE, 3) uint8 sRGB of an eye seen along its line of sight, opened out to the back.

    Args:
        head: of whose left eye the angles of iris and pupil are.
        iris: (3,) linear albedo.
        pupil_m: radius of the pupil, metres; None: that of a lit room.
    """
    ball = Eyeball.of(head.mean[part_vertices(head, "eye_left")].astype(np.float64))
    limbus = np.radians(ball.limbus_deg)
    centre = np.arange(SIZE) + 0.5
    x, y = np.meshgrid(2 * centre / SIZE - 1, 1 - 2 * centre / SIZE)
    r = np.hypot(x, y).ravel()
    flat = np.arcsin(np.clip(r / IRIS_SHARE, 0, 1) * np.sin(limbus))
    beyond = np.clip((r - IRIS_SHARE) / (RIM_SHARE - IRIS_SHARE), 0, 1) ** (1 / SPREAD)
    angle = np.where(r < IRIS_SHARE, flat, limbus + beyond * (np.radians(BACK_DEG) - limbus))
    azimuth = np.arctan2(y, x).ravel()
    direction = np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], 1)
    eye = DrawnEye(
        None, (angle / limbus).astype(np.float32), azimuth.astype(np.float32), direction.astype(np.float32),
        ball.limbus_deg, ball.pupil_deg(pupil_m), 2 / (SIZE * IRIS_SHARE),
    )  # fmt: skip
    canvas = Canvas(SIZE)
    canvas.put(np.arange(SIZE * SIZE), eye_albedo(eye, iris))
    return canvas.picture()


SPREAD = 0.8
"""Exponent of the place of the sclera on the picture: the front gets more of it."""


def _share(angle: AnyFloat, limbus: float) -> Float64:
    """Radius on the picture of angles beyond the limbus, in halves of its side."""
    beyond = np.clip((np.asarray(angle) - limbus) / (np.radians(BACK_DEG) - limbus), 0, 1)
    return np.asarray(IRIS_SHARE + (RIM_SHARE - IRIS_SHARE) * beyond**SPREAD)


def _lathe(
    rings: Sequence[tuple[float, float]], front: float, back: float | None = None, segments: int = SEGMENTS
) -> tuple[Float64, Int32]:
    """A surface of revolution about z: a pole in front, rings of (radius, depth), and a pole behind, if any."""
    turn = 2 * np.pi * np.arange(segments) / segments
    points = [np.array([[0.0, 0.0, front]])]
    for radius, depth in rings:
        points.append(np.stack([radius * np.cos(turn), radius * np.sin(turn), np.full(segments, depth)], 1))
    here, none = np.arange(segments), np.full(segments, -1)
    after = (here + 1) % segments
    faces = [np.stack([np.zeros(segments, int), 1 + here, 1 + after, none], 1)]
    for k in range(len(rings) - 1):
        a, b = 1 + k * segments, 1 + (k + 1) * segments
        faces.append(np.stack([a + here, b + here, b + after, a + after], 1))
    if back is not None:
        points.append(np.array([[0.0, 0.0, back]]))
        last, ring = 1 + len(rings) * segments, 1 + (len(rings) - 1) * segments
        faces.append(np.stack([np.full(segments, last), ring + after, ring + here, none], 1))
    return np.concatenate(points), np.concatenate(faces).astype(np.int32)


def _on_ball(
    name: str, head: HeadModel, fit: Fit, own: Int64 | Int32, points: Float64, faces: Int32, uv: Float32,
    material: Material, bone: Bone, replaces: tuple[str, ...],
) -> MeshPart:  # fmt: skip
    """A mesh that goes with every affine map of the head's own eyeball."""
    marks = np.c_[head.mean[own].astype(np.float64), np.ones(len(own))]
    weights = np.c_[points, np.ones(len(points))] @ np.linalg.pinv(marks)
    return _part(name, head, fit, points, weights, own, faces, uv, material, bone, replaces)


def _part(
    name: str, head: HeadModel, fit: Fit, points: Float64, weights: Float64, own: Int64 | Int32, faces: Int32,
    uv: Float32, material: Material, bone: Bone = "head", replaces: tuple[str, ...] = (),
) -> MeshPart:  # fmt: skip
    """A mesh (N, 3) on the mean head whose vertices follow the head's vertices ``own`` by weights (N, len(own))."""

    def moved(offsets: AnyFloat) -> Float64:
        led = np.asarray(offsets, np.float64)[own]
        # Most units leave an eye where it is.
        return np.asarray(weights @ led) if led.any() else np.zeros((len(weights), 3))

    return MeshPart(
        name=name,
        vertices=(points + moved(fit.vertices - head.mean)).astype(np.float32),
        neutral=(points + moved(fit.neutral - head.mean)).astype(np.float32),
        faces=faces,
        uv=uv,
        material=material,
        targets=targets_of(head, moved),
        bone=bone,
        replaces=replaces,
    )


def _tears(
    name: str, head: HeadModel, fit: Fit, ball: Eyeball, upper: Int64, lower: Int64, material: Material
) -> MeshPart:
    """The strip of tears between the lids' inner edge and the ball, concave towards the outside."""
    strips, faces, follow = [], [], []
    count = 0
    for row, sign in ((upper, -1.0), (lower, 1.0)):
        edge = row[np.argsort(head.mean[row, 0], kind="stable")]
        at = head.mean[edge].astype(np.float64)
        onto = at + np.array([0.0, sign * TEAR_M, 0.0])
        on_ball = ball.centre + (ball.radius + FILM_M) * ball.rays(onto)
        middle = 0.5 * (at + on_ball) + 0.25 * (ball.centre + ball.radius * ball.rays(at) - at)
        strips += [at, middle, on_ball]
        follow += [edge, edge, edge]
        n, k = len(edge), np.arange(len(edge) - 1)
        for first in (count, count + n):
            quad = np.stack([first + k, first + k + 1, first + n + k + 1, first + n + k], 1)
            faces.append(quad if sign < 0 else quad[:, ::-1])
        count += 3 * n
    points, carriers = np.concatenate(strips), np.concatenate(follow)
    own, place = np.unique(carriers, return_inverse=True)
    weights = np.eye(len(own))[place]
    uv = np.full((len(points), 2), 0.5, np.float32)
    return _part(name, head, fit, points, weights, own, np.concatenate(faces).astype(np.int32), uv, material)


def _caruncle(name: str, head: HeadModel, fit: Fit, upper: Int64, lower: Int64, material: Material) -> MeshPart:
    """The pink bump in the inner corner; it fills the gap between lids and ball there and is rooted in the skin."""
    edge = np.unique(np.concatenate([upper, lower]))
    own = edge[np.argsort(np.abs(head.mean[edge, 0]), kind="stable")[:CARUNCLE_AT]]
    corner = head.mean[own].astype(np.float64)
    side = float(np.sign(corner[:, 0].mean()))
    middle = corner.mean(0) + np.array([0.15 * side * CARUNCLE_M[0], 0.0, -CARUNCLE_BACK_M])
    theta = np.radians(np.linspace(15, 165, 8))
    unit, faces = _lathe(list(zip(np.sin(theta), np.cos(theta), strict=True)), front=1.0, back=-1.0, segments=16)
    points = middle + unit * CARUNCLE_M
    weights = np.full((len(points), len(own)), 1 / len(own))
    uv = np.full((len(points), 2), 0.5, np.float32)
    return _part(name, head, fit, points, weights, own, faces, uv, material)
