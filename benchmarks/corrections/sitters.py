"""Who sits for the photos: real shapes with real skins, some of them with painted beards and brows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from benchmarks.heads import EYE_RADIUS_M, IctHeads, Skin, TexturedHead, at_places, subdivided, varied
from benchmarks.render import Worn
from benchmarks.shoot import FFHQ_EYES_M, ffhq_head, ict_places, landmarks_on
from benchmarks.subjects import scan
from models.lightstage.references import linear, read
from service.geometry.mesh import vertex_normals

Float = npt.NDArray[np.float64]
Canvas = npt.NDArray[np.float32]

PIXELS_PER_M = 4000.0
"""Of the canvas that hair is drawn on: a hair of 0.25 mm is one pixel wide."""
HALF_WIDE_M, ABOVE_M, BELOW_M = 0.12, 0.10, 0.15
"""Extent of the canvas about the middle between the eyes."""
DARK_BROWN, BLACK = (0.022, 0.014, 0.009), (0.010, 0.009, 0.008)
"""Linear albedo of hair."""
BROWS = ((17, 21, -1.0), (22, 26, 1.0))
"""Of the 68 landmarks (Sagonas 2013) the first and the last of the subject's right and left brow; where outwards is."""


def canvas_pixels(points: Float) -> Float:
    """(N, 2) canvas pixels of (N, 2 or 3) metres, x to the subject's left, y up."""
    return np.stack([points[:, 0] + HALF_WIDE_M, ABOVE_M - points[:, 1]], 1) * PIXELS_PER_M


def blank() -> Canvas:
    """A canvas without hair, (H, W) float32."""
    return np.zeros((round((ABOVE_M + BELOW_M) * PIXELS_PER_M), round(2 * HALF_WIDE_M * PIXELS_PER_M)), np.float32)


def stroke(canvas: Canvas, start: Float, direction: Float, length_m: float, rng: np.random.Generator) -> None:
    """Draw one hair from ``start`` (2,) metres along ``direction`` (2,), bent a little, one or two pixels wide."""
    import cv2

    side = np.array([-direction[1], direction[0]]) * rng.normal(0, 0.25)
    along = np.linspace(0, 1, 4)[:, None]
    points = start + length_m * along * (direction + along * side)
    fixed = np.rint(canvas_pixels(points) * 16).astype(np.int32)
    cv2.polylines(canvas, [fixed], False, 1.0, int(rng.integers(1, 3)), cv2.LINE_AA, 4)


def brows(landmarks: Float, rng: np.random.Generator, hairs: int = 420, half_m: float = 0.0035) -> Canvas:
    """Coverage in [0, 1] of two thick brows along landmarks (68, 3), metres."""
    canvas = blank()
    for first, last, out in BROWS:
        line = landmarks[first : last + 1, :2] - [0, half_m]
        place = rng.uniform(0, len(line) - 1, hairs)
        low = np.minimum(place.astype(int), len(line) - 2)
        middle = line[low] + (place - low)[:, None] * (line[low + 1] - line[low])
        middle[:, 1] += rng.uniform(-half_m, half_m, hairs)
        for start in middle:
            direction = np.array([out, rng.normal(0.35, 0.25)])
            direction, length = direction / np.linalg.norm(direction), rng.uniform(0.003, 0.007)
            stroke(canvas, start - direction * length / 2, direction, length, rng)
    return canvas


def beard(landmarks: Float, rng: np.random.Generator, hairs: int = 4600) -> Canvas:
    """Coverage in [0, 1] of a full beard: jaw, chin and upper lip, none on the lips."""
    import cv2

    corners = landmarks[[48, 54], :2]
    jaw = landmarks[2:15, :2] * [1.02, 1.0] - [0, 0.004]
    cheeks = np.concatenate([jaw, corners[1:] + np.array([0.017, 0.004]), landmarks[35:36, :2] - [0, 0.004]])
    outline = np.concatenate([cheeks, landmarks[31:32, :2] - [0, 0.004], corners[:1] + np.array([-0.017, 0.004])])
    inside, lips = blank(), blank()
    cv2.fillPoly(inside, [np.rint(canvas_pixels(outline)).astype(np.int32)], 1.0)
    cv2.fillPoly(lips, [np.rint(canvas_pixels(landmarks[48:60])).astype(np.int32)], 1.0)
    lips = cv2.dilate(lips, np.ones((9, 9), np.uint8)).astype(np.float32)
    rows, columns = np.nonzero((inside > 0) & (lips == 0))
    canvas = blank()
    for index in rng.integers(0, len(rows), hairs):
        start = np.array([columns[index] / PIXELS_PER_M - HALF_WIDE_M, ABOVE_M - rows[index] / PIXELS_PER_M])
        direction = np.array([start[0] * 6 + rng.normal(0, 0.25), -1.0])
        stroke(canvas, start, direction / np.linalg.norm(direction), rng.uniform(0.003, 0.007), rng)
    return np.asarray(canvas * (1 - lips), np.float32)


def painted(head: TexturedHead, cover: Canvas, colour: tuple[float, float, float]) -> TexturedHead:
    """The head with hair of a linear colour where a canvas covers its front."""
    import cv2

    front = vertex_normals(head.vertices, head.triangles)[:, 2]
    pixels = canvas_pixels(head.vertices).astype(np.float32)
    step = 30_000  # remap takes no more rows
    shares = [
        cv2.remap(cover, part[:, :1].copy(), part[:, 1:].copy(), cv2.INTER_AREA, borderMode=cv2.BORDER_CONSTANT)
        for part in (pixels[i : i + step] for i in range(0, len(pixels), step))
    ]
    share = np.concatenate(shares).ravel() * np.clip(front * 4, 0, 1) * (head.vertices[:, 2] > -0.06)
    return replace(head, colours=head.colours + share[:, None] * (np.array(colour) - head.colours))


FRAME = (0.02, 0.02, 0.022)
LENS_M, RIM_M = (0.026, 0.020), 0.0016
"""Half width and half height of a rim, and its thickness."""
BEFORE_EYES_M = 0.011
"""From the front of the eyeballs to the plane of the glasses."""
CAP = (0.45, 0.05, 0.06)
CAP_M, BRIM_M = 0.007, 0.055
"""How far the cap stands off the head, and its brim off the cap."""
EDGE_M, RISE = 0.047, 0.10
"""Height of the cap's edge above the eyes in front, and how much lower it is behind, metres per metre."""


def tube(points: Float, radius: float, closed: bool = False) -> tuple[Float, npt.NDArray[np.int64]]:
    """Vertices and triangles of a round tube along points (N, 3)."""
    ahead = np.roll(points, -1, 0) - np.roll(points, 1, 0)
    if not closed:
        ahead[0], ahead[-1] = points[1] - points[0], points[-1] - points[-2]
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    side = np.cross(ahead, [0.13, 0.31, 0.94])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    around = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.cos(around)[:, None] * side[:, None] + np.sin(around)[:, None] * np.cross(ahead, side)[:, None]
    vertices = (points[:, None] + radius * ring).reshape(-1, 3)
    first = np.arange(len(points) if closed else len(points) - 1)[:, None]
    here, there = first * 12, (first + 1) % len(points) * 12
    k, after = np.arange(12)[None], (np.arange(12)[None] + 1) % 12
    quads = np.stack([here + k, there + k, there + after, here + after], -1).reshape(-1, 4)
    return vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def glasses(head: TexturedHead) -> tuple[Worn, ...]:
    """Two dark rims, the bridge between them and the temples; no glass."""
    around = np.linspace(0, 2 * np.pi, 96, endpoint=False)
    front = head.eyes[:, 2].mean() + head.eye_radius + BEFORE_EYES_M
    level = np.abs(head.vertices[:, 1]) < 0.02
    temple = np.abs(head.vertices[level, 0]).max() - 0.012
    parts = []
    for eye in head.eyes:
        middle = np.array([eye[0] * 1.04, eye[1] - 0.004, front])
        rim = middle + np.stack([LENS_M[0] * np.cos(around), LENS_M[1] * np.sin(around), 0 * around], 1)
        out = np.sign(eye[0])
        hinge = middle + np.array([out * LENS_M[0], 0.006, 0.0])
        ear = np.array([out * temple, hinge[1], -0.06])
        parts += [tube(rim, RIM_M, closed=True), tube(hinge + np.linspace(0, 1, 80)[:, None] * (ear - hinge), RIM_M)]
    inner = [np.array([eye[0] * 1.04 - np.sign(eye[0]) * LENS_M[0], eye[1], front]) for eye in head.eyes]
    along = np.linspace(0, 1, 30)[:, None]
    bow = inner[0] + along * (inner[1] - inner[0]) + 0.003 * np.sin(np.pi * along) * np.array([0, 1, 1])
    parts.append(tube(bow, RIM_M))
    return tuple(Worn(vertices, triangles, FRAME, 0.2) for vertices, triangles in parts)


def cap(head: TexturedHead) -> tuple[Worn, ...]:
    """The head's own skull, moved outwards, above an edge; and a brim before it."""
    normals = vertex_normals(head.vertices, head.triangles)
    above = head.vertices[:, 1] > EDGE_M - RISE * (0.08 - head.vertices[:, 2])
    triangles = head.triangles[above[head.triangles].all(1)]
    used, own = np.unique(triangles, return_inverse=True)
    shell = Worn((head.vertices + CAP_M * normals)[used], own.reshape(-1, 3), CAP, 0.8)
    edge = head.vertices[above & (np.abs(head.vertices[:, 1] - EDGE_M) < 0.01)]
    turn = np.linspace(-1.15, 1.15, 121)
    centre, reach = np.array([0.0, EDGE_M - 0.002, edge[:, 2].max() - 0.075]), 0.072
    rows = []
    for share in np.linspace(-0.3, 1, 60):  # it begins inside the cap
        ahead = share * BRIM_M * np.cos(turn / turn[-1] * np.pi / 2)
        r = reach + ahead
        rows.append(centre + np.stack([r * np.sin(turn), -0.25 * ahead, r * np.cos(turn)], 1))
    grid = np.arange(60 * 121).reshape(60, 121)
    a, b, c, d = grid[:-1, :-1].ravel(), grid[1:, :-1].ravel(), grid[1:, 1:].ravel(), grid[:-1, 1:].ravel()
    brim = Worn(np.concatenate(rows), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]), CAP, 0.8)
    return shell, brim


WHITE = (0.82, 0.82, 0.82)
SHIRT_M, COLLAR_M = 0.008, -0.13
"""How far the shirt stands off the body, and the height of its collar over the eyes."""


def shirt(head: TexturedHead) -> tuple[Worn, ...]:
    """The head's own neck and shoulders, moved outwards, below a collar: a white shirt."""
    below = head.vertices[:, 1] < COLLAR_M - 0.5 * (head.vertices[:, 2] + 0.02)
    triangles = head.triangles[below[head.triangles].all(1)]
    used, own = np.unique(triangles, return_inverse=True)
    normals = vertex_normals(head.vertices, head.triangles)
    return (Worn((head.vertices + SHIRT_M * normals)[used], own.reshape(-1, 3), WHITE, 0.9),)


SkinName = Literal["ffhq", "hifi3d 1", "hifi3d 2", "hifi3d 3"]
HIFI3D: Mapping[str, str] = {"hifi3d 1": "albedo.png", "hifi3d 2": "albedo_1.png", "hifi3d 3": "albedo_2.png"}
DARK_TONE = 113
"""Seed of ``benchmarks.heads.varied`` whose skin is among its darkest."""
BORDER = 32.0
"""Texels over which the faces of hifi3d go over into the rest of a head."""
SHUT: Mapping[str, float] = {"eyeBlink_L": 1.0, "eyeBlink_R": 1.0}
SMILE: Mapping[str, float] = {
    f"{unit}_{side}": weight
    for unit, weight in (("mouthSmile", 0.9), ("cheekSquint", 0.6), ("cheekRaiser", 0.5), ("mouthDimple", 0.3))
    for side in "LR"
}
BEHIND_LIDS_M = 0.006
"""By how much eyeballs stand back behind shut lids, so that nothing of them shows."""


@dataclass(frozen=True)
class Sitter:
    """One person.

    Attributes:
        shape: "ffhq" and "scan" are one head each; else a seed of ICT-FaceKit's identities, none with remainder 2 when
            divided by 3, as those come with expressions of their own.
        skin: whose albedo; the scan has its own.
        dark: the same skin in a dark tone.
        expression: ICT-FaceKit's units by weight.
        beard, brows: linear albedo of the hair; None: what the skin has.
    """

    shape: int | Literal["ffhq", "scan"]
    skin: SkinName = "ffhq"
    dark: bool = False
    expression: Mapping[str, float] = field(default_factory=dict)
    beard: tuple[float, float, float] | None = None
    brows: tuple[float, float, float] | None = None


class Studio:
    """Makes sitters out of a folder of reference heads.

    Args:
        data: the folder.
        out: keeps what takes long to make.
    """

    def __init__(self, data: Path, out: Path) -> None:
        self._data, self._out = data, out

    def head(self, sitter: Sitter) -> TexturedHead:
        """The head of a sitter, in metres, with linear colours."""
        if sitter.shape == "scan":
            return scan(self._data, self._out)[0]
        if sitter.shape == "ffhq":
            return ffhq_head(replace(self._skin, texture=self._texture(sitter.skin)))
        vertices, eyes = self._ict.posed(sitter.shape, sitter.expression)
        landmarks = vertices[self._ict.landmarks]
        colours = at_places(self._texture(sitter.skin), self._places)
        colours = varied(colours, DARK_TONE) if sitter.dark else colours
        back = BEHIND_LIDS_M if sitter.expression == SHUT else 0.0
        fine, triangles = subdivided(vertices, self._ict.triangles, 2)
        head = TexturedHead(f"ict{sitter.shape}", fine, triangles, colours, eyes - [0, 0, back], EYE_RADIUS_M)
        rng = np.random.default_rng(sitter.shape)
        if sitter.brows is not None:
            head = painted(head, brows(landmarks, rng), sitter.brows)
        if sitter.beard is not None:
            head = painted(head, beard(landmarks, rng), sitter.beard)
        return head

    @cached_property
    def _skin(self) -> Skin:
        return Skin.load(self._data / "ffhq_uv_head")

    @cached_property
    def _ict(self) -> IctHeads:
        return IctHeads(self._data / "ict_facekit_head.npz")

    @cached_property
    def _places(self) -> Float:
        cached = (self._out / "places.npy").is_file()
        reference = ffhq_head(self._skin)
        landmarks = np.zeros((0, 3)) if cached else landmarks_on(reference, self._out, "reference_skin")
        return ict_places(self._ict, self._skin, landmarks, FFHQ_EYES_M.mean(0), self._out)

    def _texture(self, skin: str) -> Float:
        if skin == "ffhq":
            return self._skin.texture
        return whole_skin(linear(read(self._data / "hifi3d_uv" / HIFI3D[skin])), self._skin.texture)


def whole_skin(face: Float, rest: Float) -> Float:
    """(H, W, 3) linear skin of a face (H, W, 3), and where that is 0, of a whole head in the tone of the face."""
    import cv2

    around = cv2.resize(rest, face.shape[1::-1], interpolation=cv2.INTER_CUBIC).clip(0, 1)
    painted = face.max(2) > 0
    tone = np.median(face[painted], 0) / np.median(around[painted], 0)
    inside = cv2.distanceTransform(painted.astype(np.uint8), cv2.DIST_L2, 3)
    share = np.clip(inside / BORDER, 0, 1)[..., None]
    return np.asarray(np.clip(share * face + (1 - share) * around * tone, 0, 1), np.float64)
