"""Beards and brows, drawn hair by hair into the true albedo of a head, as seen from its front."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from benchmarks.heads import TexturedHead
from service.geometry.normals import vertex_normals

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
