"""The rim of an opening, between lids or between lips: the pixels inside it, and the fit of the head's opening to it.

Expression units move the edges of the mesh's opening. Their activations are solved for by least squares so that the
edges, as the camera sees them, lie on the rim that a network found; with them, where it has not been settled yet, how
the whole opening lies beside that rim.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from service.arrays import AnyFloat, Bool, Float32, Float64, Int64, UInt8
from service.geometry.camera import Camera
from service.head.model import HeadModel
from service.head.regions import OpeningEdges

RIMS = {
    "left": (263, 249, 390, 373, 374, 380, 381, 382, 362, 398, 384, 385, 386, 387, 388, 466),
    "right": (33, 7, 163, 144, 145, 153, 154, 155, 133, 173, 157, 158, 159, 160, 161, 246),
    "mouth": (308, 324, 318, 402, 317, 14, 87, 178, 88, 95, 78, 191, 80, 81, 82, 13, 312, 311, 310, 415),
}
"""Landmarks round the openings, lower edge first: of the subject's eyes from the outer corner, of the mouth from the
left one."""

RIM_SIGMA_M, UNIT_SIGMA = 0.00025, 0.5
"""Standard deviations of the least squares: of the rim in metres, and of a unit's activation about its prior, the value
before."""

PLACE_SIGMA_M, TILT_SIGMA = 0.0015, 0.08
"""How far the fit places an opening beside the photo's, as a standard deviation in metres and of the tangent of an
angle: what all of both edges is off by together says nothing about how far the opening is open."""

MOST_PLACED, PLACED = 2.5, 1e-3
"""Bound of both, in standard deviations, and the share of them left to an opening that lies where it should."""

LEAST_FACING = 0.35
"""Cosine of the angle between the head's forward axis and the view below which a rim is too foreshortened to fit."""

PLACES = 9
"""Places along a rim at which the edges are fitted to it, those in the middle with more weight than those beside the
corners, where lids turn over into each other."""

ROUNDS = 4
"""Least-squares steps: which row of vertices bounds the opening, and its place along the rim, may change in each."""


@dataclass(frozen=True)
class Rim:
    """A detected rim in its own frame: place from its first corner (0) to the second (1), and height in pixels.

    Attributes:
        corner: (2,) photo pixels of the first corner.
        along: (2,) in 1/pixel: its product with an offset from the corner is the place.
        across: (2,) unit vector in photo pixels, upwards on the head: its product with that offset is the height.
        upper: (K, 2) places and heights of the upper edge, sorted by place.
        lower: the same of the lower edge.
        used: places between which edges are fitted to it.
    """

    corner: Float64
    along: Float64
    across: Float64
    upper: Float64
    lower: Float64
    used: tuple[float, float]

    @classmethod
    def of(cls, points: Float64, up: Float64, used: tuple[float, float]) -> Rim | None:
        """From detected points, or None where they are not finite or the corners coincide.

        Args:
            points: (2 K, 2) photo pixels: a corner, along the lower edge, the other corner, back along the upper edge.
            up: (2,) direction towards the head's crown: the rim of closed eyes alone does not tell it.
            used: see the attribute.
        """
        half = len(points) // 2
        first, last = points[0], points[half]
        length = float(np.linalg.norm(last - first))
        if not np.isfinite(points).all() or length < 1e-6:
            return None
        along = (last - first) / length
        across = np.array([along[1], -along[0]])
        across *= np.sign(float(across @ up)) or 1.0
        curves = []
        for between in (points[half + 1 :], points[1:half]):
            offset = np.vstack([first, between, last]) - first
            curve = np.stack([offset @ along / length, offset @ across], 1)
            curves.append(curve[np.argsort(curve[:, 0], kind="stable")])
        return cls(first, along / length, across, curves[0], curves[1], used)

    @property
    def length(self) -> float:
        """Distance between the corners in pixels."""
        return 1.0 / float(np.linalg.norm(self.along))

    @property
    def gap(self) -> float:
        """Mean height of the opening's middle half, as a share of its length."""
        places = np.linspace(0.25, 0.75, PLACES)
        return float(np.mean(np.interp(places, *self.upper.T) - np.interp(places, *self.lower.T))) / self.length

    @cached_property
    def places(self) -> Float64:
        """(N,) places at which edges are fitted to it."""
        return np.linspace(*self.used, PLACES)

    def narrower(self, height: float) -> Rim:
        """The rim with its edges moved towards each other by ``height`` pixels in all, at most until they meet."""
        places = self.upper[:, 0]
        lower = np.interp(places, self.lower[:, 0], self.lower[:, 1])
        middle, half = (self.upper[:, 1] + lower) / 2, np.maximum(self.upper[:, 1] - lower - height, 0.0) / 2
        return replace(self, upper=np.stack([places, middle + half], 1), lower=np.stack([places, middle - half], 1))


@dataclass(frozen=True)
class Edge:
    """One edge of the opening as the camera sees it, (N,) at places between its corners.

    Attributes:
        height: pixels, in the frame of the rim, of the row of vertices that bounds the opening there.
        slope: (N, U) pixels by activation of each unit.
        scale: photo pixels per metre at its depth.
        reached: bool, whether the edge reaches so far.
    """

    height: Float64
    slope: Float64
    scale: Float64
    reached: Bool

    @classmethod
    def of(
        cls, rows: tuple[Int64, ...], points: Float64, moves: Float64, camera: Camera, rim: Rim, outwards: float
    ) -> Edge | None:
        """The edge at ``rim.places``; None where it has few of them, or a vertex lies behind the camera.

        Args:
            rows: indices into the points.
            points: (N, 3) positions in metres, head space.
            moves: (U, N, 3) derivative by the activations.
            camera: of the fit.
            rim: the detected one.
            outwards: 1 for the upper edge, whose lowest row bounds the opening, -1 for the lower.
        """
        upwards, found, away = rim.across @ camera.rotation[:2], [], []
        for row in rows:
            depth = camera.to_camera(points[row])[:, 2]
            if (depth <= 1e-6).any():
                return None
            offset = camera.project(points[row]) - rim.corner
            place, scale = offset @ rim.along, camera.focal_px / depth
            order = np.argsort(place, kind="stable")
            values = np.vstack([offset @ rim.across, scale, scale * (moves[:, row] @ upwards)])[:, order]
            found.append([np.interp(rim.places, place[order], value) for value in values])
            beyond = (rim.places < place[order[0]]) | (rim.places > place[order[-1]])
            away.append(np.where(beyond, np.inf, 0.0))
        every, hidden = np.array(found), np.array(away)
        reached = np.isfinite(hidden).any(0)
        # Fewest of them that an edge has to reach.
        if reached.sum() < 5:
            return None
        bounding = np.argmin(outwards * every[:, 0] + hidden, 0)
        height, scale, *slope = every[bounding, :, np.arange(len(rim.places))].T
        return cls(height, np.stack(slope, 1), scale, reached)


@dataclass(frozen=True)
class Followed:
    """An opening that was fitted to a rim.

    Attributes:
        expression: (E,) activations, all in [0, 1].
        raised_m, aside_m: how far it has to move to lie on the rim, metres across and along the rim.
        tilt: tangent of the angle by which it has to turn, anticlockwise where ``across`` is to the left of ``along``.
    """

    expression: Float64
    raised_m: float = 0.0
    aside_m: float = 0.0
    tilt: float = 0.0


def fit_to_rim(
    rim: Rim,
    edges: OpeningEdges,
    names: set[str],
    head: HeadModel,
    neutral: AnyFloat,
    expression: Float64,
    camera: Camera,
    *,
    placed: bool = True,
) -> Followed:
    """The expression whose opening ends at a rim, and how the opening has to be moved to lie on it.

    Args:
        rim: where the edges should be seen.
        edges: of the opening.
        names: of the units that may change; names that the head lacks are ignored.
        head: the model.
        neutral: (V, 3) metres, the fitted head without expression.
        expression: (E,) activations to start from.
        camera: of the fit.
        placed: the opening lies where it should, and only its edges can move.
    """
    out = np.array(expression, np.float64)
    units = [k for k, name in enumerate(head.expression_names) if name in names]
    if not units or not -camera.rotation[2, 2] >= LEAST_FACING:
        return Followed(out)
    own = np.unique(np.concatenate(edges.upper + edges.lower))
    upper, lower = (tuple(np.searchsorted(own, row) for row in rows) for rows in (edges.upper, edges.lower))
    edges, rest = OpeningEdges(upper, lower), np.asarray(neutral, np.float64)[own]
    moves = head.expression[:, own].astype(np.float64)
    before = out[units].copy()
    away = np.zeros(3)
    sigma = np.r_[np.full(len(units), UNIT_SIGMA), PLACE_SIGMA_M, PLACE_SIGMA_M, TILT_SIGMA]
    sigma[len(units) :] *= PLACED if placed else 1.0
    places, low, high = rim.places, -MOST_PLACED * sigma[len(units) :], MOST_PLACED * sigma[len(units) :]
    middle = (4.0 * places * (1.0 - places)) ** 2
    for _ in range(ROUNDS):
        start, points = out[units], rest + np.tensordot(out, moves, 1)
        matrix, target = [np.diag(1.0 / sigma)], [np.r_[before - start, 0.0, 0.0, 0.0] / sigma]
        for rows, curve, outwards in ((edges.upper, rim.upper, 1.0), (edges.lower, rim.lower, -1.0)):
            edge = Edge.of(rows, points, moves[units], camera, rim, outwards)
            if edge is None:
                return Followed(out)
            wanted = np.interp(places, curve[:, 0], curve[:, 1])
            aside = -np.gradient(edge.height, places) * edge.scale / rim.length
            moved = np.stack([edge.scale, aside, (places - 0.5) * rim.length], 1)
            share = middle * edge.reached
            weight = np.sqrt(share / share.sum()) / (RIM_SIGMA_M * edge.scale)
            matrix.append(np.hstack([edge.slope, moved]) * weight[:, None])
            target.append((wanted - edge.height) * weight)
        bounds = np.r_[-start - 1e-9, low], np.r_[1.0 - start + 1e-9, high]
        solved = bounded_least_squares(np.vstack(matrix), np.concatenate(target), *bounds)
        out[units], away = np.clip(start + solved[: len(units)], 0.0, 1.0), solved[len(units) :]
    return Followed(out, *(float(one) for one in away))


def bounded_least_squares(matrix: Float64, target: Float64, low: Float64, high: Float64) -> Float64:
    """(n,) x in [low, high] that makes ``matrix`` (m, n) times x nearest to ``target`` (m,): an active set.

    What a bound stops is held there, until no other can move; then the one that would gain most is let go (Stark and
    Parker, Bounded-variable least squares, 1995). scipy's, which gives the same, takes 0.25 s to import.

    Args:
        matrix: (m, n) of rank n.
        target: (m,).
        low: (n,) below ``high``.
        high: (n,).
    """
    square, right = matrix.T @ matrix, matrix.T @ target
    x = np.clip(np.zeros(len(right)), low, high)
    free = (x > low) & (x < high)
    for _ in range(10 * len(x)):
        wanted = x.copy()
        wanted[free] = np.linalg.solve(square[np.ix_(free, free)], right[free] - square[np.ix_(free, ~free)] @ x[~free])
        step = wanted - x
        bound = np.where(step > 0, high, low)
        share = np.divide(bound - x, step, out=np.full(len(x), np.inf), where=step != 0)
        first = int(share.argmin())
        if share[first] < 1:
            x = np.clip(x + share[first] * step, low, high)
            x[first], free[first] = bound[first], False
            continue
        x = wanted
        down = square @ x - right
        gain = np.where(free, 0.0, np.where(x > low, down, -down))
        most = int(gain.argmax())
        if gain[most] <= 1e-12 * np.abs(right).max(initial=1.0):
            break
        free[most] = True
    return x


def inside_rim(pixels: UInt8, rim: AnyFloat, margin: float) -> tuple[Float32, Float64]:
    """Colours (n, 3) sRGB and centres (n, 2) of the pixels inside a rim (N, 2) and over ``margin`` pixels from it."""
    import cv2

    size = np.array(pixels.shape[1::-1])
    if not np.isfinite(rim).all():
        return np.zeros((0, 3), np.float32), np.zeros((0, 2))
    low = np.clip(np.floor(rim.min(0)).astype(int) - 1, 0, size - 1)
    high = np.clip(np.ceil(rim.max(0)).astype(int) + 2, low + 1, size)
    width, height = (high - low + 2).tolist()
    mask = filled(rim - low + 0.5, (height, width))
    deep = np.asarray(cv2.distanceTransform(mask, cv2.DIST_L2, 3))[1:-1, 1:-1] > max(margin, 0.5)
    rows, columns = np.nonzero(deep)
    colour = pixels[low[1] : high[1], low[0] : high[0]][rows, columns].astype(np.float32) / np.float32(255)
    return colour, np.stack([columns, rows], 1) + low + 0.5


def filled(rim: AnyFloat, shape: tuple[int, int]) -> UInt8:
    """(h, w) uint8, 1 inside the rim of the lids (N, 2), in pixels whose centres are whole numbers; elsewhere 0."""
    import cv2

    mask = np.zeros(shape, np.uint8)
    cv2.fillPoly(mask, [np.rint(rim * 16).astype(np.int32)], 1, shift=4)
    return mask
