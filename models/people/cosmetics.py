"""Make-up and earrings: with the face they are what a photo shows of who somebody is besides their hair.

Hair that is tied behind looks from the front like short hair. People who see such a photo go by the person; a reader
can do so only if synthetic people look like somebody, too. Women wear more of both, and some men do.
"""

from __future__ import annotations

import functools

import cv2
import numpy as np
import numpy.typing as npt

from models.head.eyes import sphere
from models.lightstage.skin.streams import Stream
from models.people.draw import Mesh
from models.people.figure import smooth_normals
from models.people.person import the_head
from models.people.skins import HEIGHT, WIDTH
from service.face.reading import part_labels as labels
from service.geometry.chart import Chart
from service.head.regions import vertex_mask

Float = npt.NDArray[np.float32]

MADE_UP = {False: 0.5, True: 0.02}
"""Share of women and men (True) with make-up that shows."""
EARRINGS = {False: 0.4, True: 0.05}
METALS = ((0.9, 0.62, 0.22), (0.75, 0.75, 0.75), (0.06, 0.05, 0.05), (0.85, 0.83, 0.78))
"""Linear colours: gold, silver, black, pearl."""
LOBE_SHARE = 0.12
"""Of an ear's height, from below, in which its lobe lies."""


NO_MAKE_UP: dict[str, tuple[float, ...]] = dict.fromkeys(("lipPaint", "lidPaint", "facePaint"), (0.0,) * 4)
"""Uniforms of the shader of skin for a bare face."""


@functools.lru_cache(maxsize=1)
def places() -> npt.NDArray[np.uint8]:
    """(704, 1056, 4) uint8 in the chart: upper lids with the hollow above them, edges of the lids, cheeks, brows."""
    head = the_head()
    chart = Chart.build(head, WIDTH, HEIGHT)
    groups = (("eyelid_upper_left", "eyelid_upper_right"), ("eye_socket",), ("cheek_left", "cheek_right"),
              ("brow_left", "brow_right"))  # fmt: skip
    values = chart.interpolate(np.stack([vertex_mask(head, *names) for names in groups], 1)) * chart.mask[..., None]
    for k, sigma in enumerate((4.0, 1.5, 9.0)):
        values[..., k] = cv2.GaussianBlur(np.asarray(values[..., k], np.float32), (0, 0), sigma)
    return np.asarray(np.round(255 * np.clip(values, 0, 1)), np.uint8)


def make_up(seed: int, male: bool) -> dict[str, tuple[float, ...]]:
    """Uniforms of the shader of skin.

    Returns:
        ``lipPaint`` and ``lidPaint``: linear RGB and strength in [0, 1]; ``facePaint``: strength of a line round the
        eyes, of rouge, of plucked brows, and how far foundation evens out the skin, each in [0, 1].
    """
    s = Stream(seed, "make-up")
    plucked = s.one(0.0, 0.6) if not male and s.chance(0.6) else 0.0
    if not s.chance(MADE_UP[male]):
        return NO_MAKE_UP | {"facePaint": (0.0, 0.0, plucked, 0.0)}
    red = s.one(0.12, 0.6)
    lips = (red, red * s.one(0.05, 0.55), red * s.one(0.1, 0.6), s.one(0.2, 0.9) if s.chance(0.8) else 0.0)
    dark = s.one(0.02, 0.35)
    hue = s.uniform(0.5, 1.3, 3)
    lids = (*(float(dark * h) for h in hue), s.one(0.1, 0.75) if s.chance(0.5) else 0.0)
    return {
        "lipPaint": lips, "lidPaint": lids,
        "facePaint": (s.one(0.2, 1.0) if s.chance(0.75) else 0.0, s.one(0.0, 0.5), plucked, s.one(0.0, 0.6)),
    }  # fmt: skip


def earrings(seed: int, male: bool, vertices: Float) -> list[Mesh]:
    """What hangs at the lobes of a head (V, 3), metres: studs, drops or hoops; mostly nothing."""
    s = Stream(seed, "earrings")
    if not s.chance(EARRINGS[male]):
        return []
    metal = METALS[int(s.one() * len(METALS))]
    kind = s.one()
    if kind < 0.45:
        points, triangles = _ball(s.one(0.0018, 0.005), 1.0)
    elif kind < 0.75:
        points, triangles = _ball(s.one(0.002, 0.006), s.one(2.0, 6.0))
    else:
        points, triangles = _ring(s.one(0.006, 0.028), s.one(0.0007, 0.002))
    meshes = []
    for side in ("left", "right"):
        if male and s.chance(0.5):
            continue
        at = _lobe(vertices, side) - np.array([0.0, float(points[:, 1].max()), 0.0], np.float32)
        placed = np.asarray(points + at, np.float32)
        meshes.append(
            Mesh("plain", placed, smooth_normals(placed, triangles), triangles, np.zeros((len(placed), 4), np.float32),
                 labels.OTHER, uniforms={"colour": metal, "gloss": (0.08, 0.2, 0.7, 8.0)})
        )
    return meshes


def _lobe(vertices: Float, side: str) -> Float:
    """(3,) the outermost point of an ear's lobe."""
    ear = vertices[vertex_mask(the_head(), f"ear_{side}") > 0.5]
    low, high = float(ear[:, 1].min()), float(ear[:, 1].max())
    lobe = ear[ear[:, 1] < low + LOBE_SHARE * (high - low)]
    return np.asarray(lobe[np.abs(lobe[:, 0]).argmax()], np.float32)


def _ball(radius: float, long: float) -> tuple[Float, npt.NDArray[np.int32]]:
    """A ball, ``long`` times as high as wide."""
    points, polygons = sphere((30.0, 60.0, 90.0, 120.0, 150.0))
    triangles = [polygons[:, :3], polygons[polygons[:, 3] >= 0][:, [0, 2, 3]]]
    return np.asarray(radius * points * [1.0, long, 1.0], np.float32), np.concatenate(triangles).astype(np.int32)


def _ring(radius: float, thick: float) -> tuple[Float, npt.NDArray[np.int32]]:
    """A hoop in the plane of the head's side."""
    around, across = 24, 8
    a, b = np.meshgrid(*(2 * np.pi * np.arange(n) / n for n in (around, across)), indexing="ij")
    out = radius + thick * np.cos(b)
    points = np.stack([thick * np.sin(b), out * np.cos(a), out * np.sin(a)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    corner = [((i + x) % around * across + (j + y) % across).ravel() for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    triangles = np.concatenate([np.stack([corner[k] for k in order], 1) for order in ((0, 1, 2), (0, 2, 3))])
    return np.asarray(points, np.float32), triangles.astype(np.int32)
