"""Eyes of one head: how they are painted, and their meshes: ball with the iris set back, tear line and caruncle.

An iris is six texels wide in the photo's texture, and no network here has learnt to enlarge it. But its colour is
measured in the photo, and the structure of an eye is known: pupil, radial fibres, a darker limbus, a sclera with blood
vessels. So an eye is painted by the angle from its line of sight, plainly on the head's chart and with its structure on
the picture of the mesh.

Balls are built about the head's own eyeballs and follow them affinely, so they turn with ``eyeLook*``; tear line and
caruncle follow the lids. Measures are those of adults: cornea of 7.8 mm radius (Gullstrand's eye), iris at the limbus.

The cornea is the ball's normal map, not a second mesh: the opaque iris mirrors as the dome before it does, and lies
where refraction shows it. A clear mesh needs a blend, whose alpha scales the reflection (and screens clip it before),
or refraction, which keeps a path tracer's shadow rays from the iris; this looks the same everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.anatomy.canvas import Canvas, part_points, smooth_noise
from service.anatomy.items import following
from service.arrays import AnyFloat, Float32, Float64, Int32, Int64, UInt8
from service.colour import linear_to_srgb, srgb_to_linear
from service.face.features.eye_colours import IRIS, SCLERA
from service.face.fit.fit import Fit
from service.geometry.chart import Chart
from service.geometry.mesh import area_normals, normalise
from service.head.model import HeadModel
from service.head.regions import SIDES, Eyeball, lid_edges, part_vertices
from service.materials.material import Material, OwnMap
from service.materials.part import Bone, MeshPart, part_triangles
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

    Pupil, iris of a linear albedo (3,) with a dark limbus, sclera that reddens towards the socket; ``limbus`` and
    ``pupil`` are the angles of their rims, degrees.
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
    """One eye on a picture.

    Attributes:
        radius: (N,) float32 angle from the line of sight over that of the limbus, of the texels inside.
        azimuth: (N,) float32 radians round the line of sight.
        direction: (N, 3) float32 unit vectors from the eyeball's centre.
        limbus: degrees from the line of sight to the limbus, the iris's rim.
        pupil: degrees from the line of sight to the pupil's rim.
        texel: side of a texel near the iris in iris radii.
    """

    radius: Float32
    azimuth: Float32
    direction: Float32
    limbus: float
    pupil: float
    texel: float


def eye_albedo(eye: DrawnEye, iris: Float32) -> Float32:
    """(N, 3) linear albedo of an eye with an iris of linear albedo (3,)."""
    # The same seed for both eyes: a person's are alike.
    random = np.random.default_rng(np.rint(linear_to_srgb(iris) * 255).astype(int))
    painted = paint_eye(eye.radius * eye.limbus, eye.limbus, eye.pupil, iris)
    linear = srgb_to_linear(painted) * _fibres(eye, random)[:, None]
    linear[:, 1:] *= 1 - _vessels(eye, random)[:, None]
    return np.asarray(np.clip(linear, 0, BRIGHTEST), np.float32)


def _fibres(eye: DrawnEye, random: np.random.Generator) -> Float32:
    """(N,) factor on the iris's colour: fibres and collarette; 1 on pupil and sclera."""
    # Most periods of a cosine round the iris; fewer where a texel does not resolve them.
    finest = min(70.0, np.pi * 0.5 / max(eye.texel, 1e-6))
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


SIZE = 1024
"""Side of the picture of both eyes, texels."""
SEGMENTS = 48
"""Vertices of a ring about the line of sight."""
IRIS_SHARE, RIM_SHARE = 0.55, 0.98
"""Radius of the limbus, and of the back of the ball, on the picture, in halves of its side."""
BACK_DEG = 150.0
"""Angle from the line of sight at which the ball ends, out of sight."""
RAISED_M = 0.0010
"""Height of the iris's middle before the plane of the limbus, two fifths of the cornea's: refraction raises it so."""
CORNEA_M, ASPHERICITY = 0.0078, -0.26
"""Radius of curvature of the cornea's apex, and its conic constant: it flattens outwards (Kiely et al. 1982)."""
FILM_ROUGHNESS, FILM_INDEX = 0.03, 1.576
"""Of the tear film, which is as smooth as water. It mirrors F0 = 0.05, twice what the cornea's index of 1.376 gives: in
light that is right for skin a window or a soft box would be grey in the eye, and photos show it white."""
SULCUS, WAVES = (0.93, 1.08), 0.02
"""Radii in iris radii between which cornea goes over into sclera; tilt of the film's waves there, radians."""
RELIEF_SIZE = 512
"""Side of the picture of the surface's normals, texels."""
CARUNCLE_M = (0.0016, 0.0012, 0.0010)
"""Half axes of the caruncle, across, up and forward."""
CARUNCLE_BACK_M, CARUNCLE_AT = 0.0013, 6
"""Its depth behind the inner corner, and the number of vertices of the lids' inner edge there that carry it."""
CARUNCLE, LID_MARGIN = (0.43, 0.20, 0.17), (0.48, 0.28, 0.24)
"""Diffuse albedo, linear RGB, of the caruncle, and of the wet margin of the lid that is seen through the tears."""


def eye_parts(head: HeadModel, fit: Fit, iris: AnyFloat | None, step: int = 1) -> tuple[MeshPart, ...]:
    """Both eyes of a head, on the fit's vertices; nothing for one without two eyeballs.

    ``iris`` is the (3,) linear albedo of the irises, None: the most frequent. ``step`` divides the sides of pictures.
    """
    if not all(len(part_vertices(head, f"eye_{side}")) for side in SIDES):
        return ()
    colour = IRIS if iris is None else np.asarray(iris, np.float32)
    picture = OwnMap("eyes", eye_picture(head, colour, SIZE // step))
    relief = OwnMap("eyes_normal", surface_picture(head, RELIEF_SIZE // step))
    glassy = Material("eye", colour_map=picture, roughness=FILM_ROUGHNESS, ior=FILM_INDEX, normal_map=relief)
    wet = Material("eye_tears", LID_MARGIN, roughness=0.05, ior=1.336, double_sided=True)
    flesh = Material("eye_caruncle", CARUNCLE, roughness=0.35, ior=1.4)
    made: list[MeshPart] = []
    for side in SIDES:
        bone: Bone = "eye_left" if side == "left" else "eye_right"
        own = part_vertices(head, f"eye_{side}")
        ball = Eyeball.of(head.mean[own].astype(np.float64))
        points, faces, places = globe(ball)
        name = f"eye_{side}"
        made.append(_on_ball(f"{name}_ball", head, fit, own, points, faces, places, glassy, bone, (name,)))
        edges = lid_edges(head, side)
        if edges is not None:
            made.append(_tears(f"{name}_tears", head, fit, ball, edges.upper[0], edges.lower[0], wet))
            made.append(_caruncle(f"{name}_caruncle", head, fit, edges.upper[0], edges.lower[0], flesh))
    return tuple(made)


def globe(ball: Eyeball) -> tuple[Float64, Int32, Float32]:
    """(N, 3) metres, (F, 4) faces and (N, 2) places on the picture of a ball whose iris lies behind the cornea."""
    limbus, pupil = np.radians(ball.limbus_deg), np.radians(ball.pupil_deg)
    rim, hole = ball.radius * np.sin(limbus), ball.radius * np.sin(pupil)
    plane = ball.radius * np.cos(limbus)
    # Pupil, iris, then the sphere; radius and depth of every ring.
    inside = [0.5 * hole, *(hole + share * (rim - hole) for share in (0.0, 0.2, 0.4, 0.6, 0.8, 1.0))]
    rings = [(radius, plane + RAISED_M * (1 - (radius / rim) ** 2)) for radius in inside]
    angles = np.concatenate([limbus + np.radians([3.0, 8.0, 14.0, 22.0]), np.radians(np.linspace(62, BACK_DEG, 8))])
    rings += [(ball.radius * np.sin(a), ball.radius * np.cos(a)) for a in angles]
    inner = len(rings) - len(angles)
    shares = [IRIS_SHARE * r / rim for r, _ in rings[:inner]] + [float(_share(a, limbus)) for a in angles]
    points, faces = _lathe(rings, front=plane + RAISED_M)
    turn = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    flat = np.array(shares)[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], -1)
    uv = 0.5 + 0.5 * np.concatenate([[[0.0, 0.0]], flat.reshape(-1, 2)])
    return points + ball.centre, faces, uv.astype(np.float32)


def eye_picture(head: HeadModel, iris: Float32, size: int = SIZE) -> UInt8:
    """(size, size, 3) uint8 sRGB of an eye seen along its line of sight, opened out to the back.

    The angles of iris, of linear albedo (3,), and pupil are those of the head's left eye.
    """
    ball = Eyeball.of(head.mean[part_vertices(head, "eye_left")].astype(np.float64))
    limbus = np.radians(ball.limbus_deg)
    centre = np.arange(size) + 0.5
    x, y = np.meshgrid(2 * centre / size - 1, 1 - 2 * centre / size)
    r = np.hypot(x, y).ravel()
    flat = np.arcsin(np.clip(r / IRIS_SHARE, 0, 1) * np.sin(limbus))
    beyond = np.clip((r - IRIS_SHARE) / (RIM_SHARE - IRIS_SHARE), 0, 1) ** (1 / SPREAD)
    angle = np.where(r < IRIS_SHARE, flat, limbus + beyond * (np.radians(BACK_DEG) - limbus))
    azimuth = np.arctan2(y, x).ravel()
    direction = np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], 1)
    eye = DrawnEye(
        (angle / limbus).astype(np.float32), azimuth.astype(np.float32), direction.astype(np.float32),
        ball.limbus_deg, ball.pupil_deg, 2 / (size * IRIS_SHARE),
    )  # fmt: skip
    canvas = Canvas(size)
    canvas.put(np.arange(size * size), eye_albedo(eye, iris))
    return canvas.picture()


def surface_picture(head: HeadModel, size: int = RELIEF_SIZE) -> UInt8:
    """(size, size, 3) uint8 normals, 128 + 127 n, of cornea and tear film about those of the mesh of a left eye."""
    ball = Eyeball.of(head.mean[part_vertices(head, "eye_left")].astype(np.float64))
    points, faces, uv = globe(ball)
    normals = area_normals(points, part_triangles(faces)).astype(np.float64)
    # One meridian of the mesh: place on the picture, and its normal, which renderers interpolate along the meridian.
    row = np.r_[0, np.arange(1, len(points), SEGMENTS)]
    at = 2 * uv[row, 0].astype(np.float64) - 1
    centre = np.arange(size) + 0.5
    x, y = np.meshgrid(2 * centre / size - 1, 1 - 2 * centre / size)
    r = np.hypot(x, y)
    mesh = np.arctan2(np.interp(r, at, normals[row, 0]), np.interp(r, at, normals[row, 2]))
    iris = np.clip(r / IRIS_SHARE, 0, SULCUS[1]) * ball.radius * np.sin(np.radians(ball.limbus_deg))
    dome = np.arctan2(iris, np.sqrt(np.maximum(CORNEA_M**2 - (1 + ASPHERICITY) * iris**2, (0.3 * CORNEA_M) ** 2)))
    sclera = smoothstep(r / IRIS_SHARE, *SULCUS)
    tilt = (dome - mesh) * (1 - sclera)
    places = 12 * np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3)
    waves = [WAVES * sclera * smooth_noise(places, (1.5, 3.0), seed).reshape(r.shape) for seed in (3, 4)]
    outward = np.stack([x, y], -1) / np.maximum(r, 1e-9)[..., None]
    normal = np.concatenate([np.sin(tilt)[..., None] * outward + np.stack(waves, -1), np.cos(tilt)[..., None]], -1)
    return np.asarray(np.rint(128 + 127 * normalise(normal)), np.uint8)


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

    return following(name, head, fit, head.mean, points, moved, faces, uv, material, bone=bone, replaces=replaces)


def _tears(
    name: str, head: HeadModel, fit: Fit, ball: Eyeball, upper: Int64, lower: Int64, material: Material
) -> MeshPart:
    """The strip of tears between the lids' inner edge and the ball, concave towards the outside."""
    strips, faces, follow = [], [], []
    count = 0
    for row, sign in ((upper, -1.0), (lower, 1.0)):
        edge = row[np.argsort(head.mean[row, 0], kind="stable")]
        at = head.mean[edge].astype(np.float64)
        # Height of the tear line on the ball, from the edge of the lid.
        onto = at + np.array([0.0, sign * 0.0005, 0.0])
        # Height of the tear film over the sclera.
        on_ball = ball.centre + (ball.radius + 0.00004) * ball.rays(onto)
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
